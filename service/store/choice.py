"""Which database the settings ask for."""

from __future__ import annotations

import uuid

from sqlalchemy import Engine

from service.errors import StorageError
from service.settings import MEBIBYTE, Settings
from service.store import postgres, sqlite
from service.store.database import Database
from service.store.postgres import PostgresDatabase
from service.store.sqlite import FILE, SqliteDatabase


def database_of(settings: Settings, sender: str | None = None) -> Database:
    """PostgreSQL where a URL is set, else the file in the data directory. ``sender`` names this process to others.

    Raises ``ConfigError`` for a URL that cannot be one.
    """
    url = settings.database_url.get_secret_value()
    if not url:
        return SqliteDatabase(
            settings.data_dir,
            settings.reader_threads,
            check_bytes=settings.start_check_mb * MEBIBYTE,
            reserve_bytes=settings.disk_reserve_mb * MEBIBYTE,
        )
    return PostgresDatabase(
        url,
        sender=sender or str(uuid.uuid4()),
        connections=settings.database_connections,
        reader_threads=settings.reader_threads,
        wait_s=settings.database_wait_s,
        idle_s=settings.lease_s,
    )


def looking(settings: Settings) -> Engine:
    """An engine that only reads the database as it is. Raises ``ConfigError``, ``StorageError`` where none is."""
    url = settings.database_url.get_secret_value()
    if url:
        return postgres.looking(url)
    file = settings.data_dir / FILE
    if not file.is_file():
        raise StorageError(f"there is no {file}")
    return sqlite.looking(file)
