"""The event loop keeps turning while the tracker works: the one figure that a stalled page or probe would show."""

import asyncio
import gc
import threading
import time
from pathlib import Path

import httpx
import pytest
from api_client import running
from passes import PNG, box_pass

from service.cli.serve import settle
from service.main import create_app
from service.settings import Settings

pytestmark = pytest.mark.anyio
WORST_GAP_S = 0.05


def waited_for_a_core_s() -> float:
    """How long this thread was ready to run while other programs had the cores (Linux; elsewhere 0)."""
    account = Path(f"/proc/self/task/{threading.get_native_id()}/schedstat")
    return int(account.read_text().split()[1]) / 1e9 if account.exists() else 0.0


async def measure_gaps(stop: asyncio.Event) -> list[float]:
    """Times between turns of the loop beyond the millisecond asked for, and beyond what a busy machine took."""
    gaps = []
    while not stop.is_set():
        before, waited = time.perf_counter(), waited_for_a_core_s()
        await asyncio.sleep(0.001)
        gaps.append(time.perf_counter() - before - 0.001 - (waited_for_a_core_s() - waited))
    return gaps


async def test_worst_gap_while_20_000_particles_step(tmp_path):
    given = box_pass(3, size=128)
    async with running(create_app(Settings(data_dir=tmp_path, log_level="warning"))) as api:
        session_id = await begin(api.http, given)
        await post(api.http, session_id, given.frames[0])  # the first frame also builds kernels and caches
        settle()  # as ``skypose serve`` does; here it takes the test tools' objects out too
        stop = asyncio.Event()
        gaps = asyncio.create_task(measure_gaps(stop))
        answers = [await post(api.http, session_id, image) for image in given.frames[1:]]
        stop.set()
        gc.unfreeze()
        worst = sorted(await gaps)[-5:]
    assert all(answer["particles"] == 20_000 for answer in answers)
    print(f"worst gaps {[round(gap * 1e3, 1) for gap in worst]} ms, frame {answers[-1]['timing_ms']} ms")
    assert worst[-1] < WORST_GAP_S, worst


async def begin(http: httpx.AsyncClient, given) -> str:
    model = (await http.post("/v1/models", files={"file": ("box.stl", given.mesh)})).json()
    body = {"model_id": model["model_id"], "filter": {"particles": 20_000}}
    session_id = (await http.post("/v1/sessions", json=body)).json()["session_id"]
    for image in given.background:
        await http.post(f"/v1/sessions/{session_id}/background", content=image, headers=PNG)
    return session_id


async def post(http: httpx.AsyncClient, session_id: str, image: bytes) -> dict:
    answer = await http.post(f"/v1/sessions/{session_id}/frames", content=image, headers=PNG, timeout=300)
    assert answer.status_code == 200, answer.text
    return answer.json()
