"""The store: the schema the migrations build, durability settings, transactions that fail whole."""

import asyncio

import pytest
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import event, text

from service.errors import StaleOwnerError, StorageError
from service.store import frames, models, sessions
from service.store.base import BackgroundRecord, FrameRecord, ModelRecord, Retention, SessionRecord
from service.store.database import NEWEST_REVISION, Database
from service.store.postgres import PostgresDatabase
from service.store.sqlite import SqliteDatabase
from service.store.tables import metadata

pytestmark = pytest.mark.anyio
KEEP = Retention(frame_bodies=2, particle_sets=2, particle_every=0)


def on_postgres(url: str, sender: str = "me", **settings) -> PostgresDatabase:
    given = {"connections": 3, "reader_threads": 2, "wait_s": 10.0, "idle_s": 5.0, **settings}
    return PostgresDatabase(url, sender=sender, **given)


@pytest.fixture(params=["sqlite", "postgresql"])
def make(request, tmp_path):
    """Opens one database again and again."""
    if request.param == "sqlite":
        return lambda: SqliteDatabase(tmp_path, 2)
    url = request.getfixturevalue("postgres").database()
    return lambda: on_postgres(url)


@pytest.fixture
async def database(make, anyio_backend):
    database = make()
    await database.open()
    yield database
    await database.close()


def frame(index: int, epoch: int = 1, key: str | None = None) -> FrameRecord:
    return FrameRecord(
        session_id="s",
        epoch=epoch,
        index=index,
        sha256=f"h{index}",
        idempotency_key=key,
        media_type="image/png",
        time="2026-11-20T00:00:00.000Z",
        time_given=None,
        time_s=float(index),
        query={},
        body=b"body",
        status="tracking",
        document=b'{"index":%d,"status":"tracking"}' % index,
        state=b"state%d" % index,
        created_at="t",
    )


async def begin(database: Database) -> None:
    await database.write(models.add, ModelRecord("m", "n", "glb", "blob", {}, "t"), b"mesh")
    await database.write(sessions.add, SessionRecord("s", "m", None, {}, (), "t", "t"))
    await database.write(sessions.claim, "s")


async def test_migrations_build_the_schema(database):
    def differences(connection):
        return compare_metadata(MigrationContext.configure(connection), metadata)

    assert await database.read(differences) == []


def test_newest_revision_is_known():
    config = Config()
    config.set_main_option("script_location", "service:store/migrations")
    assert ScriptDirectory.from_config(config).get_current_head() == NEWEST_REVISION


async def test_opening_again_changes_nothing(database, make):
    await begin(database)
    await database.close()
    again = make()
    await again.open()
    assert (await again.read(sessions.get, "s")).id == "s"
    await again.close()


async def test_database_of_a_newer_release_is_refused(database, make):
    await database.write(lambda connection: connection.execute(text("UPDATE alembic_version SET version_num='9999'")))
    await database.close()
    again = make()
    with pytest.raises(StorageError, match="9999"):
        await again.open()
    await again.close()


async def test_commits_are_durable(database):
    def setting(connection, text_):
        return connection.execute(text(text_)).scalar()

    if database.shared:
        assert await database.write(setting, "SHOW synchronous_commit") == "on"
    else:
        names = ("journal_mode", "synchronous", "foreign_keys")
        assert [await database.write(setting, f"PRAGMA {name}") for name in names] == ["wal", 2, 1]


async def test_directory_has_one_user(tmp_path):
    database, other = SqliteDatabase(tmp_path, 1), SqliteDatabase(tmp_path, 1)
    await database.open()
    with pytest.raises(StorageError, match="in use"):
        await other.open()
    await other.close()
    await database.close()


async def test_frame_is_stored_whole(database):
    await begin(database)
    assert [await database.write(frames.append, frame(n, key=f"k{n}"), KEEP) for n in range(3)] == [1, 2, 3]
    record, state = await database.write(sessions.claim, "s")
    assert (record.next_index, record.next_seq, record.epoch, state) == (3, 4, 2, b"state2")
    assert [e.seq for e in await database.read(frames.event_page, "s", 1, 10)] == [2, 3]
    at_index, under_key = await database.read(frames.find, "s", index=1, key="k2")
    assert (at_index.sha256, under_key.index) == ("h1", 2)


async def test_old_owner_writes_nothing(database):
    await begin(database)
    await database.write(sessions.claim, "s")
    with pytest.raises(StaleOwnerError):
        await database.write(frames.append, frame(0, epoch=1), KEEP)
    with pytest.raises(StaleOwnerError):
        await database.write(sessions.set_background, BackgroundRecord("s", 1, "h", None, "b", b"", 1, {}, "t"))
    assert (await database.read(sessions.get, "s")).next_index == 0


@pytest.mark.parametrize("index", [1, 5])
async def test_index_must_be_the_next(database, index):
    await begin(database)
    with pytest.raises(StaleOwnerError):
        await database.write(frames.append, frame(index), KEEP)


async def test_every_failing_statement_leaves_nothing(database):
    """Let the n-th statement of the transaction fail, for every n: nothing of the frame is there."""
    await begin(database)
    countdown = [0]

    def fail(*_):
        countdown[0] -= 1
        if countdown[0] == 0:
            raise OSError("disk I/O error")

    event.listen(database.writer, "before_cursor_execute", fail)
    failures = 0
    while True:
        countdown[0] = failures + 1
        try:
            await database.write(frames.append, frame(0), KEEP)
            break
        except OSError:
            failures += 1
            for table in ("frames", "frame_bodies", "estimates", "particles", "events"):
                count = lambda connection, t=table: connection.execute(text(f"SELECT count(*) FROM {t}")).scalar()  # noqa: E731
                assert await database.read(count) == 0
            assert (await database.read(sessions.get, "s")).next_index == 0
    assert failures >= 8
    assert (await database.read(sessions.get, "s")).next_index == 1


async def test_deleting_a_session_takes_its_history_and_its_background(database):
    await begin(database)
    record = BackgroundRecord("s", 1, "h", None, "sky", b"sky", 1, {}, "t")
    await database.write(sessions.set_background, record)
    await database.write(frames.append, frame(0), KEEP)
    await database.write(sessions.remove, "s")
    await database.write(models.remove, "m")

    def rows(connection):
        return sum(connection.execute(text(f"SELECT count(*) FROM {t.name}")).scalar() for t in metadata.sorted_tables)

    assert await database.read(rows) == 0


async def test_reads_go_on_beside_a_long_write(database):
    await begin(database)
    started, go_on = asyncio.Event(), asyncio.Event()
    loop = asyncio.get_running_loop()

    def slow(connection):
        connection.execute(text("UPDATE sessions SET status = 'new'"))
        loop.call_soon_threadsafe(started.set)
        asyncio.run_coroutine_threadsafe(go_on.wait(), loop).result()

    writing = asyncio.create_task(database.write(slow))
    await started.wait()
    assert (await database.read(sessions.get, "s")).status is None
    go_on.set()
    await writing
    assert (await database.read(sessions.get, "s")).status == "new"
