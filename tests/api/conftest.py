"""The application over the fake worker."""

from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest
from api_client import Api, running
from fake_worker import FakeWorker
from fastapi import FastAPI

from service.main import create_app
from service.settings import Settings
from service.workers.inline import InlineTransport


@pytest.fixture
def make_app(tmp_path: Path) -> Callable[..., FastAPI]:
    """Builds an application over the fake worker; settings as keywords."""

    def make(factory: Callable[[], Any] = FakeWorker, **settings: Any) -> FastAPI:
        return create_app(Settings(**{"data_dir": tmp_path / "data", **settings}), InlineTransport(factory))

    return make


@pytest.fixture
async def api(make_app: Callable[..., FastAPI], anyio_backend: str) -> AsyncIterator[Api]:
    """The application with default settings."""
    async with running(make_app()) as client:
        yield client
