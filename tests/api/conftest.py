"""The application over the fake worker; with SKYPOSE_TEST_POSTGRES=1 on PostgreSQL, a database per data folder."""

import os
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
def make_app(tmp_path: Path, request: pytest.FixtureRequest) -> Callable[..., FastAPI]:
    """Builds an application over the fake worker; settings as keywords."""
    databases: dict[Path, str] = {}

    def make(factory: Callable[[], Any] = FakeWorker, **settings: Any) -> FastAPI:
        given = {"data_dir": tmp_path / "data", **settings}
        if os.environ.get("SKYPOSE_TEST_POSTGRES"):
            folder = given["data_dir"]
            if folder not in databases:
                databases[folder] = request.getfixturevalue("postgres").database()
            given.setdefault("database_url", databases[folder])
        return create_app(Settings(**given), InlineTransport(factory))

    return make


@pytest.fixture
def one_process() -> None:
    """Of tests about SQLite's file, or about what a single process answers where several would try again."""
    if os.environ.get("SKYPOSE_TEST_POSTGRES"):
        pytest.skip("about one process with SQLite")


@pytest.fixture
async def api(make_app: Callable[..., FastAPI], anyio_backend: str) -> AsyncIterator[Api]:
    """The application with default settings."""
    async with running(make_app()) as client:
        yield client
