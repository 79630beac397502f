"""Which database the settings ask for."""

from __future__ import annotations

import uuid

from service.settings import Settings
from service.store.database import Database
from service.store.postgres import PostgresDatabase
from service.store.sqlite import SqliteDatabase


def database_of(settings: Settings, sender: str | None = None) -> Database:
    """PostgreSQL where a URL is set, else the file in the data directory. ``sender`` names this process to others.

    Raises ``ConfigError`` for a URL that cannot be one.
    """
    url = settings.database_url.get_secret_value()
    if not url:
        return SqliteDatabase(settings.data_dir, settings.reader_threads)
    return PostgresDatabase(
        url,
        sender=sender or str(uuid.uuid4()),
        connections=settings.database_connections,
        reader_threads=settings.reader_threads,
        wait_s=settings.database_wait_s,
        idle_s=settings.lease_s,
    )
