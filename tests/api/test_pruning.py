"""Sessions end and go by rule, told in log, metrics and audit log; one that is used is left alone."""

import pytest
from api_client import running

from service import housekeeping
from service.housekeeping import Housekeeping

pytestmark = pytest.mark.anyio
LONG_AGO = "2020-01-01T00:00:00.000Z"


@pytest.fixture(autouse=True)
def by_hand(monkeypatch) -> None:
    """The rules are carried out by the test, not by the second."""
    monkeypatch.setattr(housekeeping, "EVERY_S", 3600.0)


async def spoil(api, statement: str) -> None:
    await api.app.state.services.archive.database.write(lambda c: c.exec_driver_sql(statement) and None)


async def test_what_nobody_uses_ends_and_then_goes(make_app):
    async with running(make_app(end_idle_days=30, retain_ended_days=30)) as api:
        services = api.app.state.services
        house = Housekeeping(services, services.library._engine, services.archive.database)
        old, fresh = await api.ready_session(), await api.ready_session()
        for session_id in (old, fresh):
            assert (await api.put(session_id, 0, 0)).status_code == 200
        await spoil(api, f"UPDATE sessions SET updated_at = '{LONG_AGO}' WHERE id = '{old}'")
        await house._let_go()
        sessions = {one["session_id"]: one for one in (await api.http.get("/v1/sessions")).json()["sessions"]}
        assert sessions[old]["ended_at"] > LONG_AGO
        assert sessions[fresh]["ended_at"] is None

        lost = await api.put(
            old, 1, 1
        )  # its owner in memory has lost it; one of several processes asks again by itself
        assert lost.status_code == (409 if services.archive.database.shared else 503)
        refused = await api.put(old, 1, 1)
        assert (refused.status_code, refused.json()["setting"]) == (409, "SKYPOSE_END_IDLE_DAYS")
        url = f"/v1/sessions/{old}/background"
        assert (await api.http.post(url, content=b"x", headers={"Content-Type": "image/png"})).status_code == 409
        assert (await api.put(old, 0, 0)).json()["duplicate"] is True
        assert (await api.http.get(f"/v1/sessions/{old}/estimates/0")).status_code == 200
        assert (await api.put(fresh, 1, 1)).status_code == 200

        await spoil(api, f"UPDATE sessions SET ended_at = '{LONG_AGO}' WHERE id = '{old}'")
        services.pruning._looked_at = float("-inf")
        for _ in range(2):
            await house._let_go()
        left = [one["session_id"] for one in (await api.http.get("/v1/sessions")).json()["sessions"]]
        assert left == [fresh]
        metrics = (await api.http.get("/metrics")).text
        for action in ("end", "delete"):
            assert f'skypose_retention_total{{action="{action}"}} 1.0' in metrics
        await services.audit.store()
        told = [(one["action"], one["target"]) for one in (await api.http.get("/v1/audit")).json()["entries"]]
        assert [entry for entry in told if "retention" in entry[0]] == [
            ("retention: end", old),
            ("retention: delete", old),
        ]


async def test_one_that_was_used_since_the_rules_looked_is_left_alone(make_app):
    async with running(make_app(end_idle_days=30, retain_ended_days=30)) as api:
        pruning = api.app.state.services.pruning
        ending, going = await api.ready_session(), await api.ready_session()
        await spoil(api, f"UPDATE sessions SET updated_at = '{LONG_AGO}'")
        await spoil(api, f"UPDATE sessions SET ended_at = '{LONG_AGO}' WHERE id = '{going}'")
        look = pruning._database.read

        async def then_used(function):
            del pruning._database.read
            stamps = await look(function)
            assert (await api.put(ending, 0, 0)).status_code == 200
            await spoil(api, f"UPDATE sessions SET ended_at = NULL WHERE id = '{going}'")
            return stamps

        pruning._database.read = then_used
        assert await pruning.step() is None
        assert len((await api.http.get("/v1/sessions")).json()["sessions"]) == 2


async def test_the_size_of_the_database_and_what_is_free_are_told(make_app):
    async with running(make_app()) as api:
        services = api.app.state.services
        await Housekeeping(services, services.library._engine, services.archive.database)._measure()
        text = (await api.http.get("/metrics")).text
        lines = dict(line.rsplit(" ", 1) for line in text.splitlines() if not line.startswith("#"))
        assert float(lines["skypose_database_bytes"]) > 10_000
        free = float(lines["skypose_disk_free_bytes"])
        assert (free > 0) != services.archive.database.shared  # NaN: the disk is another machine's
