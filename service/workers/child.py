"""First module of a worker process. Imports next to nothing, so that its parent can start it early."""

from __future__ import annotations

import os
from multiprocessing.connection import Connection
from typing import Any


def run(channel: Connection, factory: str, arguments: tuple[Any, ...], nice: int) -> None:
    """Body of a worker process: see ``service.workers.host``."""
    from service.workers.host import serve

    os.nice(nice)  # the web process answers first, where they share their cores
    serve(channel, factory, arguments)
