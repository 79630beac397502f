"""The audit log: bounded in memory and on disk, whatever comes."""

from datetime import UTC, datetime, timedelta

import pytest

from service.access.audit import MOST_WAITING, Audit, Entry
from service.store.base import Page
from service.store.sqlite import SqliteDatabase

pytestmark = pytest.mark.anyio


class Clock:
    now = datetime(2026, 11, 21, tzinfo=UTC)

    def __call__(self) -> datetime:
        return self.now


@pytest.fixture
async def database(tmp_path, anyio_backend):
    database = SqliteDatabase(tmp_path, 1)
    await database.open()
    yield database
    await database.close()


def entry(outcome: int = 200, actor: str = "k", target: str = "t") -> Entry:
    return Entry("acme", actor, "127.0.0.1", "DELETE /v1/sessions/{session_id}", target, outcome, "r")


async def test_entries_are_stored_in_order_and_read_by_page(database):
    audit = Audit(database, 90, 1000, Clock())
    for n in range(5):
        audit.note(entry(target=str(n)))
    await audit.store()
    found = await audit.page("acme", 0, 3)
    assert [record.target for record in found.records] == ["0", "1", "2"]
    rest = await audit.page("acme", found.cursor, 3)
    assert ([record.target for record in rest.records], rest.cursor) == (["3", "4"], None)
    assert await audit.page("other", 0, 3) == Page((), (), None)


async def test_refusals_are_counted_and_flooding_costs_no_memory(database):
    audit, clock = Audit(database, 90, 100_000, clock := Clock()), clock
    await audit.store()
    for _ in range(1000):
        audit.note(entry(401))
    for n in range(2 * MOST_WAITING):
        audit.note(entry(401, actor=str(n)))
    assert len(audit._refused) <= MOST_WAITING + 1
    await audit.store()
    assert await audit.page("acme", 0, 10) == Page((), (), None)  # within the minute nothing is written
    clock.now += timedelta(seconds=61)
    await audit.store()
    found = (await audit.page("acme", 0, 100_000)).records
    assert found[0].count == 1000
    assert sum(record.count for record in found) == 1000 + 2 * MOST_WAITING


async def test_old_entries_and_those_past_the_limit_are_dropped(database):
    clock = Clock()
    audit = Audit(database, 30, 10, clock)
    for _ in range(15):
        audit.note(entry())
    await audit.store()
    assert len((await audit.page("acme", 0, 100)).records) == 10
    clock.now += timedelta(days=31)
    audit.note(entry(target="new"))
    await audit.store()
    assert [record.target for record in (await audit.page("acme", 0, 100)).records] == ["new"]
