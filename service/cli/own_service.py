"""The whole service within a command: no port, its tracker in a thread, its data in a folder that goes with it."""

from __future__ import annotations

import logging
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import httpx
import structlog
from anyio.from_thread import BlockingPortal, start_blocking_portal
from fastapi import FastAPI

from service.client import Client
from service.main import create_app
from service.settings import Settings
from service.workers.inline import InlineTransport
from service.workers.tracker import Tracker

_URL = "http://127.0.0.1"
_FILE_MB = 2048  # the caller's own: a night's SER file is no attack
_FRAMES = 100_000  # of one file, whose first is drawn when the last has been tracked


class OwnTransport(httpx.BaseTransport):
    """Calls of a client, answered by an application in the event loop of another thread."""

    def __init__(self, portal: BlockingPortal, app: FastAPI) -> None:
        self._portal, self._asgi = portal, httpx.ASGITransport(app)

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        """The whole answer: also of a file of several frames, once all are tracked."""
        return self._portal.call(self._answer, request)

    async def _answer(self, request: httpx.Request) -> httpx.Response:
        answer = await self._asgi.handle_async_request(request)
        return httpx.Response(answer.status_code, headers=answer.headers, content=await answer.aread())


@contextmanager
def own_service() -> Iterator[Client]:
    """A client of a service that begins and ends with this."""
    with ExitStack() as stack:
        stack.enter_context(_warnings_only())
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="skypose-")))
        # Defaults only: SKYPOSE_… in the environment speaks of another service, its database among it.
        settings = Settings.model_construct(
            data_dir=folder,
            max_frame_mb=_FILE_MB,
            max_pending_mb=2 * _FILE_MB,
            keep_frame_bodies=_FRAMES,
            keep_particle_sets=1,
        )
        app = create_app(settings, InlineTransport(Tracker))
        portal = stack.enter_context(start_blocking_portal())
        stack.enter_context(portal.wrap_async_context_manager(app.router.lifespan_context(app)))
        yield stack.enter_context(Client(_URL, transport=OwnTransport(portal, app)))


@contextmanager
def _warnings_only() -> Iterator[None]:
    """Its log on standard error, without the lines about every call."""
    before = structlog.get_config()
    quiet = structlog.make_filtering_bound_logger(logging.WARNING)
    structlog.configure(wrapper_class=quiet, logger_factory=structlog.PrintLoggerFactory(sys.stderr))
    try:
        yield
    finally:
        structlog.configure(**before)
