"""A damaged file is found before the service starts, and one that was removed is not made anew beside it."""

import sqlite3
from contextlib import closing

import pytest
from test_database import begin

from service.errors import StorageError
from service.store import sessions
from service.store.sqlite import FILE, RESERVE, SqliteDatabase

pytestmark = pytest.mark.anyio


async def test_a_scrambled_file_is_refused(tmp_path):
    database = SqliteDatabase(tmp_path, 1)
    await database.open()
    await begin(database)
    await database.close()
    whole = (tmp_path / FILE).read_bytes()
    with closing(sqlite3.connect(tmp_path / FILE)) as connection:
        page = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = 'estimates'").fetchone()[0]
    (tmp_path / FILE).write_bytes(whole[: (page - 1) * 4096] + bytes(4096) + whole[page * 4096 :])
    damaged = SqliteDatabase(tmp_path, 1)
    with pytest.raises(StorageError, match="damaged"):
        await damaged.open()
    await damaged.close()
    unchecked = SqliteDatabase(tmp_path, 1, check_bytes=0)  # a large file is not read to its end at each start
    await unchecked.open()
    await unchecked.close()
    (tmp_path / FILE).write_bytes(whole)
    again = SqliteDatabase(tmp_path, 1)
    await again.open()
    assert (await again.read(sessions.get, "s")).id == "s"
    await again.close()


async def test_the_reserve_is_there_and_a_removed_database_is_not_made_anew(tmp_path):
    database, beside = SqliteDatabase(tmp_path, 1, reserve_bytes=1 << 20), SqliteDatabase(tmp_path, 1)
    await database.open()
    room = await database.room()
    assert (tmp_path / RESERVE).stat().st_size == 1 << 20
    assert room.used == sum(file.stat().st_size for file in tmp_path.glob(f"{FILE}*"))
    assert room.free > 0
    (tmp_path / FILE).unlink()
    with pytest.raises(StorageError, match="removed"):
        await beside.open(beside=True)
    assert not (tmp_path / FILE).exists()
    await beside.close()
    await database.close()
