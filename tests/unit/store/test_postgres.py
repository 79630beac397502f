"""What only PostgreSQL has: lost connections, deadlocks, several processes, leases, signals."""

import asyncio
import threading

import pytest
from sqlalchemy import event, text

from service.errors import ConfigError, InputError, NotFoundError, QuotaExceededError, StaleOwnerError, StorageError
from service.store import api_keys, frames, instances, models, sessions
from service.store.base import FrameRecord, KeyRecord, ModelRecord, Quotas, Retention, SessionRecord, TicketRecord
from service.store.instances import Instance
from service.store.postgres import PostgresDatabase
from service.store.signals import Signal
from service.store.tickets import add as add_ticket
from service.store.tickets import take as take_ticket

pytestmark = pytest.mark.anyio
KEEP = Retention(2, 2, 0)
A, B = Instance("a", "http://a"), Instance("b", "http://b")


@pytest.fixture
async def opened(postgres, anyio_backend):
    """Opens processes' connections to one database."""
    url, made = postgres.database(), []

    async def make(sender: str = "me", **settings) -> PostgresDatabase:
        given = {"connections": 4, "reader_threads": 1, "wait_s": 10.0, "idle_s": 5.0, **settings}
        made.append(PostgresDatabase(url, sender=sender, **given))
        await made[-1].open()
        return made[-1]

    yield make
    for database in made:
        await database.close()


@pytest.fixture
async def database(opened):
    return await opened()


async def begin(database: PostgresDatabase) -> None:
    await database.write(models.add, ModelRecord("m", "n", "glb", "blob", {}, "t"), b"mesh")
    await database.write(sessions.add, session("s"))


def session(session_id: str) -> SessionRecord:
    return SessionRecord(session_id, "m", None, {"filter": {"particles": 10}}, (), "t", "t")


def frame(index: int, epoch: int) -> FrameRecord:
    head = {"session_id": "s", "epoch": epoch, "index": index, "sha256": "h", "idempotency_key": None, "query": {}}
    times = {"time": "t", "time_given": None, "time_s": float(index), "created_at": "t"}
    content = {"media_type": "image/png", "body": b"", "status": "tracking", "document": b"{}", "state": b"s"}
    return FrameRecord(**head, **times, **content)


def end_own_connection(connection) -> None:
    """As a restart of the server would."""
    pid = connection.execute(text("SELECT pg_backend_pid()")).scalar()
    with connection.engine.connect() as other:
        other.execute(text("SELECT pg_terminate_backend(:pid, 5000)"), {"pid": pid})


def end_other_connections(connection) -> None:
    """As a restart of the server would, once more."""
    others = "FROM pg_stat_activity WHERE datname = current_database() AND pid <> pg_backend_pid()"
    connection.execute(text(f"SELECT pg_terminate_backend(pid, 5000) {others}"))


async def status_of(database: PostgresDatabase) -> str | None:
    return (await database.read(sessions.get, "s")).status


async def test_a_connection_lost_before_the_commit_is_tried_again(database):
    await begin(database)
    tries = []

    def note(connection):
        connection.execute(text("UPDATE sessions SET status = coalesce(status, '') || 'x'"))
        tries.append(1)
        if len(tries) == 1:
            end_own_connection(connection)
        connection.execute(text("SELECT 1"))

    await database.write(note)
    assert (await status_of(database), len(tries)) == ("x", 2)


async def test_a_lost_commit_is_an_error_that_says_so(database):
    await begin(database)
    lost = []

    def lose(connection):
        if not lost:
            lost.append(1)
            end_own_connection(connection)

    event.listen(database.writer, "commit", lose)
    with pytest.raises(StorageError, match="not known"):
        await database.write(lambda connection: connection.execute(text("UPDATE sessions SET status = 'new'")) and None)
    assert await status_of(database) is None


async def test_a_deadlock_is_tried_again(database):
    await begin(database)
    await database.write(sessions.add, session("r"))
    meeting, tries = threading.Barrier(2), []

    def note(connection, first, second):
        tries.append(first)
        connection.execute(text("UPDATE sessions SET status = 'new' WHERE id = :s"), {"s": first})
        if tries.count(first) == 1:
            meeting.wait(30)  # now each has what the other wants
        connection.execute(text("UPDATE sessions SET status = 'new' WHERE id = :s"), {"s": second})

    await asyncio.gather(database.write(note, "s", "r"), database.write(note, "r", "s"))
    assert (await status_of(database), len(tries)) == ("new", 3)


async def test_quotas_hold_when_many_ask_at_once(database):
    await begin(database)
    asked = [database.write(sessions.add, session(f"s{n}"), Quotas(sessions=3)) for n in range(8)]
    answers = await asyncio.gather(*asked, return_exceptions=True)
    assert [type(answer) for answer in answers].count(QuotaExceededError) == 6
    assert len((await database.read(sessions.page, "default", 0, 100)).records) == 3


async def test_a_session_has_one_owner_while_its_lease_lasts(database):
    await begin(database)
    for one in (A, B):
        await database.write(instances.register, one, 60.0)
    record, _ = await database.write(sessions.claim, "s", "a")
    assert await database.write(sessions.claim, "s", "b") == A
    assert await database.read(instances.owner, "s") == A
    assert await database.read(instances.live) == [B, A]
    # Its lease runs out: another takes it, and it can write no more.
    await database.write(instances.beat, A, -1.0)
    taken, _ = await database.write(sessions.claim, "s", "b")
    assert taken.epoch == record.epoch + 1
    with pytest.raises(StaleOwnerError):
        await database.write(frames.append, frame(0, record.epoch), KEEP)
    with pytest.raises(StaleOwnerError):
        await database.read(frames.find, "s", index=0, key=None, epoch=record.epoch)
    assert await database.write(frames.append, frame(0, taken.epoch), KEEP) == 1
    # Handed over, and released: only by whoever has it.
    assert not await database.write(instances.release, "s", record.epoch, "a", "a")
    assert await database.write(instances.release, "s", taken.epoch, "b", "a")
    await database.write(instances.beat, A, 60.0)
    assert await database.write(sessions.claim, "s", "b") == A
    again, _ = await database.write(sessions.claim, "s", "a")
    assert await database.write(instances.release, "s", again.epoch, "a")
    assert await database.read(instances.owner, "s") is None


async def test_a_dead_owner_is_replaced(database):
    await begin(database)
    for one in (A, B):
        await database.write(instances.register, one, 60.0)
    await database.write(sessions.claim, "s", "a")
    assert isinstance(await database.write(sessions.claim, "s", "b", "a"), tuple)  # nobody listens where it was
    # A new process at the address of another: that one has gone.
    await database.write(instances.register, Instance("c", "http://b"), 60.0)
    assert await database.read(instances.owner, "s") is None
    await database.write(sessions.remove, "s")
    with pytest.raises(NotFoundError):
        await database.write(sessions.claim, "s", "c")


async def test_a_stopped_process_keeps_nobody_waiting_and_writes_nothing(opened):
    stopped, other = await opened(idle_s=0.3), await opened("other")
    await begin(other)
    record, _ = await other.write(sessions.claim, "s")
    holds, goes_on = asyncio.Event(), threading.Event()
    loop = asyncio.get_running_loop()

    def append(connection):
        sessions.get(connection, "s", hold=True)
        loop.call_soon_threadsafe(holds.set)
        assert goes_on.wait(30)  # stopped in the middle of its transaction, which holds the session's row
        return frames.append(connection, frame(0, record.epoch), KEEP)

    writing = asyncio.create_task(stopped.write(append))
    await holds.wait()
    await other.write(sessions.claim, "s")
    goes_on.set()
    with pytest.raises(StaleOwnerError):
        await writing
    assert (await other.read(sessions.get, "s")).next_index == 0


async def listening(*databases: PostgresDatabase) -> asyncio.Queue[Signal | None]:
    """What they hear, once all do; None whenever one begins to."""
    heard: asyncio.Queue[Signal | None] = asyncio.Queue()
    loop = asyncio.get_running_loop()
    for database in databases:
        database.listen(
            lambda signal: loop.call_soon_threadsafe(heard.put_nowait, signal),
            lambda: loop.call_soon_threadsafe(heard.put_nowait, None),
        )
    assert [await heard.get() for _ in databases] == [None] * len(databases)
    return heard


async def test_signals_are_heard_by_the_others_after_the_commit(opened):
    here, there = await opened("here"), await opened("there")
    heard = await listening(here, there)  # nobody hears itself
    await begin(here)

    def fails(connection):
        sessions.remove(connection, "s")
        raise InputError("no")

    with pytest.raises(InputError):
        await here.write(fails)
    await here.write(sessions.remove, "s")
    await here.write(api_keys.add, KeyRecord("k", "h", "acme", "read", "n", "t"))
    await here.write(api_keys.revoke, "acme", "k", "t")
    expected = [Signal("deleted", "s"), Signal("revoked", "k")]
    assert [await heard.get() for _ in expected] == expected
    assert heard.empty()


async def test_that_logs_grow_is_told_together_and_beside_the_transactions(opened):
    here, there = await opened("here"), await opened("there")
    heard = await listening(here, there)
    notified = []
    event.listen(here.writer, "before_cursor_execute", lambda *given: notified.append("pg_notify" in given[2]))
    await begin(here)
    record, _ = await here.write(sessions.claim, "s")
    assert await here.write(frames.append, frame(0, record.epoch), KEEP) == 1
    assert notified and not any(notified)
    for number in range(1, 1001):
        here.tell(Signal("grown", "s", number))
        here.tell(Signal("grown", "r", number))
    newest, count = {}, 0
    while newest != {"s": 1000, "r": 1000}:
        signal = await heard.get()
        assert signal.number > newest.get(signal.key, 0)
        newest[signal.key], count = signal.number, count + 1
    assert count < 2000
    # A connection that breaks costs at most what was on its way.
    await there.write(end_other_connections)
    number = 1000
    while (signal := heard.get_nowait() if not heard.empty() else None) is None or signal.number <= 1000:
        number += 1
        here.tell(Signal("grown", "s", number))
        await asyncio.sleep(0)


async def test_a_ticket_is_taken_once_and_in_time(database):
    for digest, lifetime_s in (("good", 60.0), ("late", -1.0)):
        await database.write(add_ticket, TicketRecord(digest, "acme", "k", None), lifetime_s, 10)
    assert (await database.write(take_ticket, "good")).tenant == "acme"
    assert [await database.write(take_ticket, digest) for digest in ("good", "late", "never")] == [None] * 3


async def test_all_processes_have_one_secret(opened):
    databases = [await opened(name) for name in ("a", "b")]
    assert len(set(await asyncio.gather(*(database.write(instances.secret) for database in databases)))) == 1


async def test_text_that_cannot_be_stored_is_the_callers_fault(database):
    await begin(database)
    with pytest.raises(InputError):
        await database.write(models.add, ModelRecord("x", "\0", "glb", "blob", {}, "t"), b"mesh")
    with pytest.raises(NotFoundError):
        await database.read(frames.estimate, "s", 2**53)


async def test_a_server_that_is_not_there_is_waited_for_and_then_named():
    url = "postgresql://nobody:secret@127.0.0.1:1/none"
    database = PostgresDatabase(url, sender="me", connections=1, reader_threads=1, wait_s=0.1, idle_s=1)
    with pytest.raises(StorageError, match="refused") as refused:
        await database.open()
    assert "secret" not in refused.value.detail
    await database.close()


@pytest.mark.parametrize("url", ["mysql://h/d", "no url", "postgresql+asyncpg://h/d"])
def test_other_databases_are_refused(url):
    with pytest.raises(ConfigError):
        PostgresDatabase(url, sender="me", connections=1, reader_threads=1, wait_s=1, idle_s=1)
