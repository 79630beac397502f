"""Checkpoints written by earlier releases are read by this one.

``python tests/api/test_golden.py NAME`` records a new one, when the format changes; old ones stay.
"""

import asyncio
import json
import sys
import tempfile
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).resolve().parents[1]))
from api_client import running
from fake_worker import CUBE, FakeWorker

from service.main import create_app
from service.settings import Settings
from service.workers.inline import InlineTransport

GOLDEN = Path(__file__).parent / "golden"


@pytest.mark.anyio
@pytest.mark.parametrize("file", sorted(GOLDEN.glob("*.skypose")), ids=lambda file: file.stem)
async def test_checkpoint_of_an_earlier_release_goes_on(api, file):
    expected = json.loads(file.with_suffix(".json").read_text())
    session_id = expected[0]["session_id"]
    answer = await api.http.put(f"/v1/sessions/{session_id}/checkpoint", content=file.read_bytes())
    assert answer.status_code == 201, answer.text
    found = (await api.http.get(f"/v1/sessions/{session_id}/estimates")).json()["estimates"]
    assert found == expected
    assert (await api.put(session_id, 2, 2)).json()["duplicate"] is True
    assert (await api.put(session_id, 3, 3)).json()["index"] == 3


async def record(name: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        app = create_app(Settings(data_dir=Path(folder)), InlineTransport(FakeWorker))
        async with running(app) as api:
            session_id = await api.ready_session(CUBE + b"joint", joints={"free": "all"}, name="golden")
            for n in range(3):
                await api.put(session_id, n, n, time=f"2026-11-20T03:04:0{n}.5Z")
            blob = await api.http.get(f"/v1/sessions/{session_id}/checkpoint")
            estimates = (await api.http.get(f"/v1/sessions/{session_id}/estimates")).json()["estimates"]
    (GOLDEN / f"{name}.skypose").write_bytes(blob.content)
    (GOLDEN / f"{name}.json").write_text(json.dumps(estimates, indent=1) + "\n")


if __name__ == "__main__":
    asyncio.run(record(sys.argv[1]))
