"""One changed digit, wherever it is stored, is told when it is read, and never served."""

import pytest
from sqlalchemy import text
from test_database import KEEP, begin, frame

from service.errors import DamagedError
from service.store import api_keys, audit, checkpoints, frames, models, sessions
from service.store.base import (
    AuditRecord,
    BackgroundRecord,
    FrameRecord,
    KeyRecord,
    Page,
    SessionRecord,
    StoredContender,
)
from service.store.sqlite import SqliteDatabase

pytestmark = pytest.mark.anyio


@pytest.fixture
async def database(tmp_path, anyio_backend):
    database = SqliteDatabase(tmp_path, 1)
    await database.open()
    await begin(database)
    await database.write(sessions.set_background, BackgroundRecord("s", 1, "h", "b", "sky", b"sky 1", 1, {}, "t"))
    for index in range(3):
        record = FrameRecord(**{**vars(frame(index, key=f"k{index}")), "belief": b"belief%d" % index})
        await database.write(frames.append, record, KEEP)
    await database.write(api_keys.add, KeyRecord("k", "h", "default", "read", "n", "t", "2027-01-01T00:00:00Z"))
    await database.write(audit.append, [AuditRecord("t", "default", "k", "a", "GET /", str(n), 200) for n in range(3)])
    yield database
    await database.close()


def found_key(connection, key_id):
    """One key; raises what is wrong with it."""
    found = api_keys.find_all(connection, [key_id])[key_id]
    if isinstance(found, DamagedError):
        raise found
    return found


READS = {
    "models.name = 'N'": (models.get, "m"),
    "models.report = '{\"faces\": 1}'": (models.get, "m"),
    "blobs.data = x'00'": (models.get_blob, "sky"),
    "sessions.config = '{\"seed\": 1}'": (sessions.get, "s"),
    "sessions.config = '{'": (sessions.claim, "s"),
    "sessions.name = 'other'": (sessions.get, "s"),
    "backgrounds.sha256 = 'x'": (sessions.find_background, "s", "b"),
    "frames.sha256 = 'h1'": (frames.find, "s"),
    "frames.media_type = 'image/jpeg'": (frames.body, "s", 2),
    "frames.time_s = time_s + 1e-9": (frames.belief_page, "s", 0),
    "frame_bodies.body = x'00'": (frames.body, "s", 2),
    "estimates.document = x'7b7d'": (frames.estimate, "s", None),
    "estimates.document = replace(document, '1', '2')": (frames.estimate_page, "s", -1, 10),
    "particles.state = x'00'": (frames.particle_set, "s", None),
    "beliefs.belief = x'00'": (frames.belief_page, "s", 0),
    "events.idx = (idx + 1) % 3": (frames.event_page, "s", 0, 10),
    "sessions.next_index = 2": (sessions.claim, "s"),
    "sessions.time_s = time_s + 1": (sessions.claim, "s"),
    "sessions.status = 'lost'": (sessions.claim, "s"),
    "api_keys.role = 'admin'": (found_key, "k"),
    "api_keys.tenant = 'other'": (found_key, "k"),
    "api_keys.sha256 = 'g'": (found_key, "k"),
    "api_keys.expires_at = NULL": (found_key, "k"),
    "api_keys.rates = '{'": (found_key, "k"),
}


async def test_what_was_changed_is_not_served(database):
    for change, (read, *given) in READS.items():
        keywords = {"index": 2, "key": None} if read is frames.find else {}
        table, _, assignment = change.partition(".")

        def spoil(connection, read=read, given=given, keywords=keywords, update=f"UPDATE {table} SET {assignment}"):
            read(connection, *given, **keywords)
            connection.execute(text(update))
            read(connection, *given, **keywords)
            raise AssertionError(f"served after {update}")

        with pytest.raises(DamagedError, match=r"not as it was stored|cannot be read|do not fit"):
            await database.write(spoil)


async def test_an_estimate_in_the_place_of_another_is_not_served(database):
    await database.write(lambda c: c.execute(text("DELETE FROM estimates WHERE idx = 1")) and None)
    await database.write(lambda c: c.execute(text("UPDATE estimates SET idx = 1 WHERE idx = 0")) and None)
    with pytest.raises(DamagedError, match="session_id s, idx 1"):
        await database.read(frames.estimate, "s", 1)


async def test_a_compared_model_is_sealed_and_a_checkpoint_of_damaged_rows_is_none(database):
    await database.write(sessions.put_contenders, "s", [StoredContender("m", b"state", -1.5)])
    assert (await database.read(checkpoints.read, "s")).compared[0].contender.log_evidence == -1.5
    await database.write(lambda c: c.execute(text("UPDATE contenders SET log_evidence = -1.25")) and None)
    with pytest.raises(DamagedError, match="contenders"):
        await database.read(checkpoints.read, "s")


async def test_what_is_damaged_can_be_deleted(database):
    await database.write(lambda c: c.execute(text("UPDATE sessions SET config = '[]'")) and None)
    await database.write(sessions.remove, "s")
    assert await database.read(sessions.page, "default", 0, 10) == Page((), (), None)


@pytest.mark.parametrize("change", ["name = 'other'", "config = '{'"])
async def test_a_damaged_row_does_not_hide_the_others_of_its_page(database, change):
    await database.write(sessions.add, SessionRecord("after", "m", None, {}, (), "t", "t"))
    await database.write(lambda c: c.execute(text(f"UPDATE sessions SET {change} WHERE id = 's'")) and None)
    found = await database.read(sessions.page, "default", 0, 10)
    assert ([one.id for one in found.records], found.damaged, found.cursor) == (["after"], ("s",), None)
    first = await database.read(sessions.page, "default", 0, 1)
    assert (first.records, first.damaged) == ((), ("s",))
    assert (await database.read(sessions.page, "default", first.cursor, 1)).records == found.records


async def test_a_damaged_key_can_be_ended_and_hides_no_other(database):
    await database.write(api_keys.add, KeyRecord("other", "h", "default", "read", "n", "t", rates={"calls": 1.5}))
    await database.write(
        lambda c: c.execute(text("UPDATE api_keys SET rates = '{', role = 'admin' WHERE id = 'k'")) and None
    )
    found = await database.read(api_keys.page, "default", 0, 10)
    assert ([one.id for one in found.records], found.damaged, found.cursor) == (["other"], ("k",), None)
    await database.write(api_keys.revoke, "default", "k", "now")
    await database.write(api_keys.touch, {"other": "now"})
    await database.write(api_keys.revoke, "default", "other", "now")
    assert (await database.read(found_key, "other")).revoked_at == "now"  # what changes is under no checksum
    ended = await database.read(lambda c: c.execute(text("SELECT revoked_at FROM api_keys WHERE id = 'k'")).scalar())
    assert ended == "now"


async def test_an_audit_entry_that_was_changed_is_told_beside_the_others(database):
    await database.write(lambda c: c.execute(text("UPDATE audit SET outcome = 403 WHERE target = '1'")) and None)
    found = await database.read(audit.page, "default", 0, 10)
    assert ([one.target for one in found.records], len(found.damaged)) == (["0", "2"], 1)
