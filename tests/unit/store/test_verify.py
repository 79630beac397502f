"""``verify`` finds every damaged row, foreign row and gap, says which, and changes nothing."""

import sqlite3

import pytest
from test_database import KEEP, begin, frame, make  # noqa: F401 -- a fixture
from test_migrations import database_of

from service.errors import StorageError
from service.store import frames, sessions, sqlite
from service.store.base import BackgroundRecord, StoredContender
from service.store.verify import verify

pytestmark = pytest.mark.anyio


class Undone(Exception):
    """Rolls a transaction back."""


@pytest.fixture
async def database(make, anyio_backend):  # noqa: F811
    database = make()
    await database.open()
    await begin(database)
    await database.write(sessions.set_background, BackgroundRecord("s", 1, "h", None, "sky", b"sky", 1, {}, "t"))
    for index in range(3):
        await database.write(frames.append, frame(index), KEEP)
    await database.write(sessions.put_contenders, "s", [StoredContender("m", b"state", -1.5)])
    yield database
    await database.close()


async def found(database) -> tuple[list[str], object]:
    lines: list[str] = []
    counts = await database.read(lambda connection: verify(connection, lines.append))
    return lines, counts


async def test_a_whole_database_has_no_problem(database):
    lines, counts = await found(database)
    assert lines == []
    # 2 blobs, model, session, background; frames, estimates and events, 2 bodies, 2 particle sets; a contender
    assert (counts.sessions, counts.frames, counts.rows, counts.unsealed) == (1, 3, 5 + 9 + 4 + 1, 0)


CHANGES = {
    "UPDATE models SET name = 'N'": "models (id m) is not as it was stored",
    "UPDATE blobs SET checksum = 'x' WHERE key = 'sky'": "blobs (key sky) is not as it was stored",
    "UPDATE frames SET sha256 = 'h' WHERE idx = 1": "frames (session_id s, idx 1) is not as it was stored",
    "UPDATE contenders SET log_evidence = 1": "contenders (session_id s, ordinal 0) is not as it was stored",
    "DELETE FROM frames WHERE idx = 1": "session s: frames 0 to 2 (3) are wanted, 0 to 2 (2) found",
    "DELETE FROM estimates WHERE idx = 2": "session s: event 3 is of no estimate",
    "DELETE FROM events": "session s: events 1 to 3 (3) are wanted, none found",
    "DELETE FROM particles": "session s: its state, the particles of frame 2, is missing",
    "UPDATE sessions SET next_index = 2": "session s: frames 0 to 1 (2) are wanted, 0 to 2 (3) found",
    "UPDATE sessions SET time_s = 7": "session s: its time is not that of its last frame",
    "UPDATE sessions SET status = 'lost'": "session s: its status is not that of its last estimate",
    "UPDATE frames SET checksum = NULL": None,
}


async def test_what_is_wrong_is_named(database):
    for change, wanted in CHANGES.items():
        lines: list[str] = []

        def look(connection, change=change, lines=lines):
            connection.exec_driver_sql(change)
            lines.append(verify(connection, lines.append))
            raise Undone

        with pytest.raises(Undone):
            await database.write(look)
        *told, counts = lines
        if wanted is None:
            assert (told, counts.unsealed, counts.problems) == ([], 3, 0)
        else:
            assert wanted in told, change
            assert counts.problems == len(told), change
    assert (await found(database))[0] == []


async def test_sqlite_tells_foreign_rows_and_damaged_documents(tmp_path):
    database = sqlite.SqliteDatabase(tmp_path, 1)
    await database.open()
    await begin(database)
    await database.close()
    with sqlite3.connect(tmp_path / sqlite.FILE) as connection:  # without foreign_keys
        connection.execute("DELETE FROM blobs")
        connection.execute("UPDATE sessions SET config = '{'")
    connection.close()
    lines: list[str] = []
    engine = sqlite.looking(tmp_path / sqlite.FILE)
    with engine.connect() as looked:
        verify(looked, lines.append)
    engine.dispose()
    assert lines == ["models: 1 with blob_key blob, which is not in blobs", "sessions (id s) is not as it was stored"]


@pytest.mark.parametrize("revision", ["0001", "0005"])
async def test_databases_of_earlier_releases_are_looked_at_as_they_are(tmp_path, revision):
    database_of(tmp_path, revision)
    with sqlite3.connect(tmp_path / sqlite.FILE) as connection:
        connection.execute("INSERT INTO blobs VALUES ('b', x'00')")
    connection.close()
    before = (tmp_path / sqlite.FILE).read_bytes()
    engine = sqlite.looking(tmp_path / sqlite.FILE)
    with engine.connect() as looked:
        counts = verify(looked, pytest.fail)
    engine.dispose()
    assert (counts.rows, counts.unsealed) == (1, 1)
    assert (tmp_path / sqlite.FILE).read_bytes() == before


async def test_what_is_no_database_of_ours_is_refused(tmp_path):
    with sqlite3.connect(tmp_path / sqlite.FILE) as connection:
        connection.execute("CREATE TABLE t (x)")
    connection.close()
    engine = sqlite.looking(tmp_path / sqlite.FILE)
    with engine.connect() as looked, pytest.raises(StorageError, match="no database"):
        verify(looked, pytest.fail)
    engine.dispose()
