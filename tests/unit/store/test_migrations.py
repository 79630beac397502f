"""A database of an earlier release opens in this one: what it holds belongs to the tenant ``default``."""

import sqlite3

import pytest
from alembic import command
from alembic.config import Config
from sqlalchemy import create_engine, text

from service.store import api_keys, models, sessions
from service.store.base import KeyRecord, ModelRecord, Page, SessionRecord
from service.store.scope import model_key, public_id, session_key, tenant_of
from service.store.sqlite import SqliteDatabase

pytestmark = pytest.mark.anyio


def database_of(folder, revision: str) -> None:
    config = Config()
    config.set_main_option("script_location", "service:store/migrations")
    engine = create_engine(f"sqlite+pysqlite:///{folder}/skypose.sqlite3")
    with engine.begin() as connection:
        config.attributes["connection"] = connection
        command.upgrade(config, revision)
    engine.dispose()


async def test_rows_from_before_there_were_tenants(tmp_path):
    database_of(tmp_path, "0002")
    with sqlite3.connect(tmp_path / "skypose.sqlite3") as connection:
        connection.execute("INSERT INTO blobs VALUES ('b', x'00')")
        connection.execute("INSERT INTO models VALUES (1, 'm', 'n', 'glb', 'b', NULL, '{}', 't')")
        names = "id, model_id, config, warnings, created_at, updated_at, epoch, next_index, next_seq, background_frames"
        connection.execute(f"INSERT INTO sessions ({names}) VALUES ('s', 'm', '{{}}', '[]', 't', 't', 0, 0, 1, 0)")
    connection.close()
    database = SqliteDatabase(tmp_path, 1)
    await database.open()
    try:
        record = await database.read(sessions.get, session_key("default", "s"))
        assert (record.tenant, record.model_id) == ("default", "m")
        assert [model.id for model in (await database.read(models.page, "default", 0, 10)).records] == ["m"]
        assert (await database.read(models.page, "acme", 0, 10)).records == ()
        # Two tenants may hold what is the same.
        theirs = ModelRecord(model_key("acme", "m"), "n", "glb", "b", {}, "t", tenant="acme")
        await database.write(models.add, theirs, b"\0")
        session = SessionRecord(session_key("acme", "s"), theirs.id, None, {}, (), "t", "t", tenant="acme")
        await database.write(sessions.add, session)
        assert [found.id for found in (await database.read(sessions.page, "acme", 0, 10)).records] == ["acme/s"]
        assert (public_id(session.id), tenant_of(session.id), tenant_of(record.id)) == ("s", "acme", "default")
        await database.write(api_keys.add, KeyRecord("k", "h", "acme", "read", "n", "t"))
        assert await database.read(api_keys.page, "default", 0, 10) == Page((), (), None)
    finally:
        await database.close()


async def test_keys_of_the_release_before_are_taken_and_new_ones_are_sealed(tmp_path):
    database_of(tmp_path, "0007")
    with sqlite3.connect(tmp_path / "skypose.sqlite3") as connection:
        names = "id, sha256, tenant, role, name, created_at"
        connection.execute(f"INSERT INTO api_keys ({names}) VALUES ('old', 'h', 'acme', 'admin', 'n', 't')")
    connection.close()
    database = SqliteDatabase(tmp_path, 1)
    await database.open()
    try:
        await database.write(api_keys.add, KeyRecord("new", "h", "acme", "read", "n", "t"))
        for key_id in ("old", "new"):
            await database.write(
                lambda c, k=key_id: c.execute(text(f"UPDATE api_keys SET name = '!' WHERE id = '{k}'"))
            )
        found = await database.read(api_keys.page, "acme", 0, 10)
        assert ([one.id for one in found.records], found.damaged) == (["old"], ("new",))
    finally:
        await database.close()


async def test_a_second_user_may_stand_beside_a_service_of_this_release(tmp_path):
    service, beside = SqliteDatabase(tmp_path, 1), SqliteDatabase(tmp_path, 1)
    await service.open()
    await beside.open(beside=True)
    await beside.write(api_keys.add, KeyRecord("k", "h", "acme", "read", "n", "t"))
    assert (await service.read(api_keys.find_all, ["k"]))["k"].tenant == "acme"
    await beside.close()
    await service.close()
