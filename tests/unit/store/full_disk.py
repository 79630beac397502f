"""Run by test_full_disk on a small disk of its own: fill it, delete, go on; delete after a start on a full disk too."""

import asyncio
import os
import shutil
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from service.errors import StorageError
from service.store import frames, models, sessions
from service.store.base import FrameRecord, ModelRecord, Retention, SessionRecord
from service.store.sqlite import RESERVE, SqliteDatabase

KEEP = Retention(frame_bodies=10_000, particle_sets=2, particle_every=0)
FRAME = FrameRecord("", 1, 0, "h", None, "image/png", "t", None, 0.0, {}, b"", "tracking", b"", b"", "t")


async def append(database: SqliteDatabase, session: str, index: int) -> None:
    body = os.urandom(60_000)
    record = replace(FRAME, session_id=session, index=index, body=body, document=body[:9000], state=body[:9000])
    await database.write(frames.append, record, KEEP)


async def fill(database: SqliteDatabase, session: str) -> int:
    """Frames until the disk is full, to the last byte. Returns the index of the next."""
    index = (await database.read(sessions.get, session)).next_index
    try:
        while True:
            await append(database, session, index)
            index += 1
    except StorageError as error:
        assert "full" in error.detail, error.detail
    fill_up(database._directory)
    return index


def fill_up(folder: Path) -> None:
    """A stranger's file in what is left."""
    with suppress(OSError), (folder / "stranger").open("ab", buffering=0) as file:
        while True:
            file.write(bytes(4096))


async def main(folder: Path) -> None:
    database = SqliteDatabase(folder, 1, reserve_bytes=8 << 20)
    await database.open()
    await database.write(models.add, ModelRecord("m", "n", "glb", "blob", {}, "t"), b"mesh")
    for name in ("a", "b", "c"):
        await database.write(sessions.add, SessionRecord(name, "m", None, {}, (), "t", "t"))
        await database.write(sessions.claim, name)
    for index in range(80):
        await append(database, "a", index)
        await append(database, "b", index)
    last = await fill(database, "c")
    assert shutil.disk_usage(folder).free == 0
    try:
        await database.write(sessions.remove, "a")
        raise AssertionError("not full: it could be deleted without the reserve")
    except StorageError:
        await database.free(sessions.remove, "a")
    await append(database, "c", last)  # in the pages of what was deleted, although the disk is as full as before
    assert (folder / RESERVE).stat().st_size > 4 << 20, "the reserve is taken again"
    await database.close()

    fill_up(folder)
    database = SqliteDatabase(folder, 1, reserve_bytes=8 << 20)
    await database.open()
    await database.free(sessions.remove, "b")
    assert [one.id for one in (await database.read(sessions.page, "default", 0, 9)).records] == ["c"]
    assert (await database.read(sessions.get, "c")).next_index == last + 1
    await database.close()


asyncio.run(main(Path(sys.argv[1])))
