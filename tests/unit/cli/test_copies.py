"""``skypose backup``, ``restore`` and ``verify``: what is printed, exit codes, what is refused."""

import asyncio
import sqlite3

import pytest
from typer.testing import CliRunner

from service.cli import app
from service.store import models, sessions
from service.store.base import ModelRecord, SessionRecord
from service.store.postgres import PostgresDatabase
from service.store.sqlite import FILE, RESERVE, SqliteDatabase


@pytest.fixture
def used(tmp_path):
    """A data directory in use: its newest commits are in the log only."""
    folder = tmp_path / "data"
    database = SqliteDatabase(folder, 1, reserve_bytes=1 << 20)

    async def begin() -> None:
        await database.open()
        await database.write(models.add, ModelRecord("m", "n", "glb", "blob", {}, "t"), b"mesh")
        await database.write(sessions.add, SessionRecord("s", "m", None, {}, (), "t", "t"))

    with asyncio.Runner() as runner:
        runner.run(begin())
        yield folder
        runner.run(database.close())


def run(*given: object):
    return CliRunner().invoke(app, [str(one) for one in given])


def names(file) -> list[str]:
    with sqlite3.connect(file) as connection:
        found = [row[0] for row in connection.execute("SELECT id FROM sessions")]
    connection.close()
    return found


def test_a_copy_of_a_database_in_use_is_put_back_elsewhere(used, tmp_path):
    copy, elsewhere = tmp_path / "copy.sqlite3", tmp_path / "elsewhere"
    made = run("backup", copy, "--data", used)
    assert (made.exit_code, "sessions 1, frames 0, rows 3, problems 0" in made.stdout) == (0, True)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["copy.sqlite3", "data"]
    assert run("verify", copy).exit_code == 0
    (elsewhere / "kernels").mkdir(parents=True)
    assert run("restore", copy, "--data", elsewhere).exit_code == 0
    assert names(elsewhere / FILE) == ["s"]
    assert run("verify", "--data", elsewhere).exit_code == 0


def test_what_would_be_overwritten_is_refused(used, tmp_path):
    copy = tmp_path / "copy.sqlite3"
    assert run("backup", copy, "--data", used).exit_code == 0
    again = run("backup", copy, "--data", used)
    assert (again.exit_code, "give another name" in again.output) == (2, True)
    in_use = run("restore", copy, "--data", used)
    assert (in_use.exit_code, "in use" in in_use.output) == (2, True)
    other = tmp_path / "other"
    other.mkdir()
    (other / RESERVE).touch()
    (other / "notes.txt").touch()
    held = run("restore", copy, "--data", other)
    assert (held.exit_code, "not empty: notes.txt" in held.output) == (2, True)
    assert run("backup", tmp_path / "no.sqlite3", "--data", tmp_path / "nowhere").exit_code == 2
    assert run("verify", "--data", tmp_path / "nowhere").exit_code == 2


def test_a_damaged_copy_is_told_and_not_put_back(used, tmp_path):
    copy, elsewhere = tmp_path / "copy.sqlite3", tmp_path / "elsewhere"
    with sqlite3.connect(used / FILE) as connection:
        connection.execute("UPDATE blobs SET data = x'00'")
    connection.close()
    told = run("backup", copy, "--data", used)
    assert (told.exit_code, "blobs (key blob) is not as it was stored" in told.stdout) == (1, True)
    assert copy.exists()
    assert run("verify", copy).exit_code == 1
    assert run("restore", copy, "--data", elsewhere).exit_code == 1
    assert not elsewhere.exists()
    (tmp_path / "text").write_text("no database")
    assert run("verify", tmp_path / "text").exit_code == 2
    assert run("restore", tmp_path / "text", "--data", elsewhere).exit_code == 2


def test_postgres_is_verified_as_it_is(postgres, monkeypatch):
    url = postgres.database()
    monkeypatch.setenv("SKYPOSE_DATABASE_URL", url)
    empty = run("verify")
    assert (empty.exit_code, "no database of this release" in empty.output) == (2, True)
    database = PostgresDatabase(url, sender="me", connections=1, reader_threads=1, wait_s=10.0, idle_s=5.0)

    async def begin() -> None:
        await database.open()
        await database.write(models.add, ModelRecord("m", "n", "glb", "blob", {}, "t"), b"mesh")
        await database.write(lambda connection: connection.exec_driver_sql("UPDATE models SET name = 'N'") and None)
        await database.close()

    asyncio.run(begin())
    told = run("verify")
    assert (told.exit_code, told.stdout.splitlines()) == (
        1,
        ["models (id m) is not as it was stored", "sessions 0, frames 0, rows 2, problems 1"],
    )


def test_postgres_is_told_its_own_tools(tmp_path, monkeypatch):
    monkeypatch.setenv("SKYPOSE_DATABASE_URL", "postgresql+psycopg://nobody@localhost/none")
    for command in ("backup", "restore"):
        told = run(command, tmp_path / "copy")
        assert (told.exit_code, "pg_dump" in told.output) == (2, True)
