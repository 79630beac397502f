"""Clients of the application: in this process through httpx's ASGI transport, or on a real port."""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import cv2
import httpx
import numpy as np
import uvicorn
from fake_worker import CUBE
from fastapi import FastAPI

from service.api.door import server_config
from service.api.schemas import Estimate

PNG = {"Content-Type": "image/png"}


def image(n: int = 0, size: tuple[int, int] = (16, 16)) -> bytes:
    """A small PNG that differs for every ``n``."""
    pixels = np.random.default_rng(n).integers(0, 255, size, dtype=np.uint8)
    return cv2.imencode(".png", pixels)[1].tobytes()


class Api:
    """A client with the few calls that most tests begin with."""

    def __init__(self, http: httpx.AsyncClient, app: FastAPI | None = None) -> None:
        self.http = http
        self.app = app

    async def model(self, data: bytes = CUBE, name: str = "cube.glb", **form: str) -> httpx.Response:
        return await self.http.post("/v1/models", files={"file": (name, data)}, data=form)

    async def session(self, data: bytes = CUBE, **body: Any) -> str:
        model_id = (await self.model(data)).json()["model_id"]
        answer = await self.http.post("/v1/sessions", json={"model_id": model_id, **body})
        assert answer.status_code == 201, answer.text
        return answer.json()["session_id"]

    async def ready_session(self, data: bytes = CUBE, **body: Any) -> str:
        session_id = await self.session(data, **body)
        answer = await self.http.post(f"/v1/sessions/{session_id}/background", content=image(), headers=PNG)
        assert answer.status_code == 200, answer.text
        return session_id

    async def post(self, session_id: str, n: int, headers: dict[str, str] | None = None, **query: Any):
        return await self.http.post(
            f"/v1/sessions/{session_id}/frames", content=image(n), headers={**PNG, **(headers or {})}, params=query
        )

    async def estimate(self, session_id: str, n: int = 0, **query: Any) -> dict[str, Any]:
        """The answer to a frame, checked against its schema."""
        answer = await self.post(session_id, n, **query)
        assert answer.status_code == 200, answer.text
        Estimate.model_validate(answer.json())
        return answer.json()

    async def put(self, session_id: str, index: int, n: int, **query: Any):
        url = f"/v1/sessions/{session_id}/frames/{index}"
        return await self.http.put(url, content=image(n), headers=PNG, params=query)


@asynccontextmanager
async def running(app: FastAPI) -> AsyncIterator[Api]:
    """The application within its lifespan, without a server."""
    async with app.router.lifespan_context(app):
        transport = httpx.ASGITransport(app, raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=60) as http:
            yield Api(http, app)


@asynccontextmanager
async def served(app: FastAPI, port: int = 0) -> AsyncIterator[str]:
    """The application on a real port (0: a free one), in this event loop. Yields ``host:port``."""
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    listener.bind(("127.0.0.1", port))
    host, port = listener.getsockname()
    server = uvicorn.Server(server_config(app, timeout_graceful_shutdown=5))
    server.capture_signals = contextlib.nullcontext  # type: ignore[method-assign]
    task = asyncio.create_task(server.serve(sockets=[listener]))
    try:
        while not server.started:
            await asyncio.sleep(0)
            if task.done():
                task.result()
        yield f"{host}:{port}"
    finally:
        app.state.services.hub.stop()
        server.should_exit = True
        await task
        listener.close()
