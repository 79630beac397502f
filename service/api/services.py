"""What the routes work with, put together by ``service.main``."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, cast

from fastapi import Depends
from starlette.requests import HTTPConnection

from service.access.audit import Audit
from service.access.gate import Gate
from service.access.keys import Keys
from service.access.limits import Limits
from service.access.stored import StoredBytes
from service.access.tickets import Tickets
from service.api.forwarding import Forwarding
from service.api.submissions import Submissions
from service.metrics import Metrics
from service.sessions.admission import Admission, Places
from service.sessions.archive import Archive
from service.sessions.batch import Batches
from service.sessions.checkpoint import Checkpoints
from service.sessions.hub import Hub
from service.sessions.library import Library
from service.sessions.objects import Objects
from service.sessions.pruning import Pruning
from service.sessions.registry import Registry
from service.sessions.report import Reports
from service.sessions.status import Status
from service.settings import Settings


@dataclass(frozen=True)
class Services:
    """The application's rooms."""

    settings: Settings
    metrics: Metrics
    hub: Hub
    registry: Registry
    pruning: Pruning
    library: Library
    archive: Archive
    objects: Objects
    reports: Reports
    checkpoints: Checkpoints
    batches: Batches
    batch_places: Places
    status: Status
    admission: Admission
    submissions: Submissions
    forwarding: Forwarding
    gate: Gate
    keys: Keys
    tickets: Tickets
    limits: Limits
    stored: StoredBytes
    audit: Audit
    started: datetime


def services_of(connection: HTTPConnection) -> Services:
    """The rooms of the application that this request reached."""
    return cast(Services, connection.app.state.services)


async def _services(connection: HTTPConnection) -> Services:
    # A coroutine: FastAPI would run a plain function in a thread, and calls could overtake each other there.
    return services_of(connection)


ServicesDep = Annotated[Services, Depends(_services)]
