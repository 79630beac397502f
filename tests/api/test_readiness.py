"""When the store cannot keep what it is given: acknowledging stops at once, and /readyz says why."""

import math
import shutil
import sqlite3

import pytest
from api_client import running
from sqlalchemy import event
from sqlalchemy.exc import OperationalError

from service.housekeeping import Housekeeping
from service.sessions import status
from service.store.sqlite import FILE, RESERVE

pytestmark = [pytest.mark.anyio, pytest.mark.usefixtures("one_process")]


def remove(folder, name):
    (folder / name).unlink()


def replace(folder, name):
    shutil.copy(folder / name, folder / "copy")
    (folder / "copy").rename(folder / name)


@pytest.mark.parametrize("name", [FILE, f"{FILE}-wal", f"{FILE}-shm"])
@pytest.mark.parametrize("do", [remove, replace])
async def test_a_file_taken_away_stops_acknowledging(make_app, tmp_path, do, name):
    async with running(make_app()) as api:
        session_id = await api.ready_session()
        assert (await api.put(session_id, 0, 0)).status_code == 200
        assert (await api.http.get("/readyz")).json() == {
            "status": "ok",
            "checks": {"worker": True, "database": True},
            "reasons": [],
        }
        do(tmp_path / "data", name)
        for index in (1, 0, 1):  # a new frame, one that is stored, the new one again
            refused = await api.put(session_id, index, index)
            assert (refused.status_code, refused.json()["type"]) == (503, "urn:skypose:problem:storage-failed")
            assert f"{name} was removed or replaced" in refused.json()["detail"]
        ready = await api.http.get("/readyz")
        assert (ready.status_code, ready.json()["checks"]["database"]) == (503, False)
        assert f"{name} was removed or replaced" in ready.json()["reasons"][0]
        assert (await api.http.get("/healthz")).status_code == 200


async def test_a_data_directory_taken_away_is_told_and_stops_nothing_else(make_app, tmp_path):
    async with running(make_app(disk_reserve_mb=1)) as api:
        services = api.app.state.services
        shutil.rmtree(tmp_path / "data")
        ready = await api.http.get("/readyz")
        assert (ready.status_code, len(ready.json()["reasons"])) == (503, 1)
        await Housekeeping(services, services.library._engine, services.archive.database)._measure()
        assert (await api.http.get("/healthz")).status_code == 200


async def test_sessions_and_models_are_deleted_with_what_is_kept_for_it(make_app, tmp_path):
    reserve = tmp_path / "data" / RESERVE

    def full_while_it_is_kept(*_):
        if reserve.exists():
            error = sqlite3.OperationalError("database or disk is full")
            error.sqlite_errorcode = sqlite3.SQLITE_FULL
            raise OperationalError("statement", {}, error)

    async with running(make_app(disk_reserve_mb=1)) as api:
        session_id = await api.ready_session()
        model_id = (await api.http.get(f"/v1/sessions/{session_id}")).json()["model_id"]
        writer = api.app.state.services.archive.database.writer
        event.listen(writer, "before_cursor_execute", full_while_it_is_kept)
        assert (await api.put(session_id, 0, 0)).status_code == 503
        for path in (f"sessions/{session_id}", f"models/{model_id}"):
            assert (await api.http.delete(f"/v1/{path}")).status_code == 204
            assert (await api.http.get(f"/v1/{path}")).status_code == 404
            assert reserve.stat().st_size == 1 << 20
        event.remove(writer, "before_cursor_execute", full_while_it_is_kept)


async def test_a_full_disk_and_a_database_that_takes_no_write_are_not_ready(make_app, tmp_path):
    async with running(make_app(min_free_mb=1 << 40)) as api:
        ready = await api.http.get("/readyz")
        assert (ready.status_code, ready.json()["status"]) == (503, "starting")
        assert "SKYPOSE_MIN_FREE_MB" in ready.json()["reasons"][0]
    async with running(make_app()) as api:
        database = api.app.state.services.archive.database
        await database.write(lambda connection: connection.exec_driver_sql("PRAGMA query_only = ON") and None)
        ready = await api.http.get("/readyz")
        assert (ready.status_code, ready.json()["checks"]) == (503, {"worker": True, "database": False})
        assert "readonly" in ready.json()["reasons"][0]


async def test_readiness_writes_seldom_however_often_it_is_asked(make_app):
    async with running(make_app()) as api:
        database, now = api.app.state.services.archive.database, [0.0]
        found = status.Status(database, api.app.state.services.library._engine, 0, lambda: now[0])

        def count(connection):
            return connection.exec_driver_sql("SELECT sum(count) FROM probes").scalar()

        written = []
        for now[0] in (0.0, 0.1, status.WRITE_EVERY_S - 0.1, status.WRITE_EVERY_S, math.inf):
            assert (await found.checks()).reasons == ()
            written.append(await database.read(count))
        assert written == [1, 1, 1, 2, 3]
