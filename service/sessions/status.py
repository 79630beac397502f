"""How the service is: ready, and on what it runs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sqlalchemy import Connection, text

from service.store.database import Database
from service.workers.engine import Engine


class Status:
    """Asks the rooms."""

    def __init__(self, database: Database, engine: Engine) -> None:
        self._database = database
        self._engine = engine

    async def checks(self) -> dict[str, bool]:
        """What must be true before frames can be taken. Raises ``StorageError``."""
        await self._database.read(_answers)
        return {"worker": self._engine.transport.ready, "database": True}

    async def worker(self) -> Mapping[str, Any]:
        """Devices, scorer and versions, as a worker sees them."""
        return await self._engine.describe()

    def processes(self) -> list[dict[str, Any]]:
        """The worker processes."""
        return [dict(process) for process in self._engine.transport.processes()]


def _answers(connection: Connection) -> None:
    connection.execute(text("SELECT 1"))
