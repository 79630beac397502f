"""The database fails, at every call in turn: the client hears 503, its retry is answered, nothing is lost or twice."""

import os
import sqlite3

import pytest
from api_client import running
from sqlalchemy import event
from sqlalchemy.exc import OperationalError

from service.errors import StorageError

pytestmark = pytest.mark.anyio
# The long form: SKYPOSE_TEST_SWEEP_FRAMES=20
N_FRAMES = int(os.environ.get("SKYPOSE_TEST_SWEEP_FRAMES", "4"))


class Fault:
    """Fails the n-th statement or commit from now on, once."""

    def __init__(self, database) -> None:
        self.left = 0
        for engine in (database.writer, database.reader):
            event.listen(engine, "before_cursor_execute", self.strike)
            event.listen(engine, "commit", self.strike)

    def strike(self, *_) -> None:
        self.left -= 1
        if self.left == 0:
            raise OperationalError("statement", {}, sqlite3.OperationalError("disk I/O error"))


def comparable(estimate: dict) -> dict:
    return {key: estimate[key] for key in estimate if key not in ("time", "timing_ms", "session_id", "duplicate")}


async def undisturbed(make_app, tmp_path) -> list[dict]:
    async with running(make_app(data_dir=tmp_path / "calm")) as api:
        session_id = await api.ready_session()
        return [comparable((await api.put(session_id, n, n)).json()) for n in range(N_FRAMES)]


@pytest.mark.usefixtures("one_process")
async def test_every_failing_call_of_a_session_is_survived(make_app, tmp_path):
    expected = await undisturbed(make_app, tmp_path)
    app = make_app()
    failures = 0
    async with running(app) as api:
        session_id = await api.ready_session()
        fault = Fault(app.state.services.archive.database)
        answers = []
        for n in range(N_FRAMES):
            nth = 1
            while True:
                fault.left = nth
                answer = await api.put(session_id, n, n)
                if answer.status_code == 200 and not answer.json()["duplicate"]:
                    break
                assert answer.status_code == 503, answer.text
                assert answer.json()["type"] == "urn:skypose:problem:storage-failed"
                nth, failures = nth + 1, failures + 1
            fault.left = 0
            answers.append(comparable(answer.json()))
        found = (await api.http.get(f"/v1/sessions/{session_id}/estimates")).json()["estimates"]
        session = (await api.http.get(f"/v1/sessions/{session_id}")).json()
    assert answers == [comparable(estimate) for estimate in found] == expected
    assert session["last_seq"] == N_FRAMES
    assert failures >= 10 * N_FRAMES
    print(f"{failures} failing calls in {N_FRAMES} frames")


@pytest.mark.usefixtures("one_process")
async def test_full_disk_is_refused_and_survived(make_app, tmp_path):
    expected = await undisturbed(make_app, tmp_path)
    app = make_app()
    async with running(app) as api:
        session_id = await api.ready_session()
        await limit_pages(app, 1)  # SQLite takes its present size then: full from here on
        refused = await api.put(session_id, 0, 0)
        assert (refused.status_code, refused.json()["type"]) == (503, "urn:skypose:problem:storage-failed")
        assert (await api.http.get(f"/v1/sessions/{session_id}/estimates")).json()["estimates"] == []
        await limit_pages(app, 1 << 30)
        assert [comparable((await api.put(session_id, n, n)).json()) for n in range(N_FRAMES)] == expected


async def limit_pages(app, pages: int) -> None:
    def set_limit(connection) -> None:
        connection.exec_driver_sql(f"PRAGMA max_page_count = {pages}")

    await app.state.services.archive.database.write(set_limit)


async def test_answer_lost_after_the_commit_is_found_again(make_app, monkeypatch):
    app = make_app()
    async with running(app) as api:
        session_id = await api.ready_session()
        database = app.state.services.archive.database
        write = database.write

        async def forgetful(function, *args):
            result = await write(function, *args)
            if function.__name__ == "append":
                raise StorageError("the commit took place, its answer was lost")
            return result

        monkeypatch.setattr(database, "write", forgetful)
        assert (await api.put(session_id, 0, 0)).status_code == 503
        monkeypatch.undo()
        assert (await api.put(session_id, 0, 0)).json()["duplicate"] is True
        assert (await api.put(session_id, 1, 1)).json()["index"] == 1
