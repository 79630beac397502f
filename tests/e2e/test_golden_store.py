"""A database that an earlier release wrote is brought up to date, served bit for bit, and gone on from.

``golden/store-REVISION.sqlite3.xz`` is the database of a service of that revision (the last release's is one of them)
that tracked the first three frames of ``golden/session-1.npz``.
"""

import lzma
import sqlite3
from contextlib import closing

import numpy as np
import pytest
from passes import PNG
from test_golden_session import GOLDEN, application

from service.store.sqlite import FILE
from service.store.verify import verify

pytestmark = pytest.mark.anyio
TRACKED = 3


@pytest.mark.parametrize("file", sorted(GOLDEN.glob("store-*.sqlite3.xz")), ids=lambda file: file.name)
async def test_a_database_of_an_earlier_release_goes_on(file, tmp_path):
    (tmp_path / FILE).write_bytes(lzma.decompress(file.read_bytes()))
    with closing(sqlite3.connect(tmp_path / FILE)) as stored:
        ((session_id,),) = stored.execute("SELECT id FROM sessions")
        documents = [row[0] for row in stored.execute("SELECT document FROM estimates ORDER BY idx")]
    assert len(documents) == TRACKED
    with np.load(GOLDEN / "session-1.npz") as recorded:
        images = [recorded[f"frame{n}"].tobytes() for n in range(TRACKED + 1)]
    async with application(tmp_path) as api:
        database, here = api.app.state.services.archive.database, f"/v1/sessions/{session_id}"
        before = await database.read(lambda connection: verify(connection, pytest.fail))
        assert before.unsealed == before.rows > 0, "its rows are of a time before there were checksums"
        answers = [(await api.http.get(f"{here}/estimates/{n}")).content for n in range(TRACKED)]
        assert answers == documents
        assert (await api.http.get(here)).json()["ended_at"] is None
        assert [key["name"] for key in (await api.http.get("/v1/keys")).json()["keys"]] == ["old"]
        again = await api.http.put(f"{here}/frames/0", content=images[0], headers=PNG)
        assert again.json()["duplicate"] is True
        following = await api.http.put(f"{here}/frames/{TRACKED}", content=images[TRACKED], headers=PNG)
        assert following.json()["status"] in ("acquiring", "ambiguous", "tracking")  # its filter of outlines is no more
        after = await database.read(lambda connection: verify(connection, pytest.fail))
        assert after.rows - after.unsealed >= 5, "frame, file, estimate, particles and event of the new frame"
