"""The service over HTTP, as its clients see it, with every byte counted."""

from __future__ import annotations

from types import TracebackType
from typing import Any

import httpx

from service.bench.load.clients import Answer
from service.bench.load.plan import LoadError
from service.bench.load.scene import Scene

_PNG = {"Content-Type": "image/png"}
_TIMEOUT_S = 300.0
_LATER = (httpx.codes.TOO_MANY_REQUESTS, httpx.codes.SERVICE_UNAVAILABLE)


class HttpTarget:
    """A service at an address; an async context manager."""

    def __init__(
        self, url: str, key: str | None, scene: Scene, transport: httpx.AsyncBaseTransport | None = None
    ) -> None:
        self._http = httpx.AsyncClient(
            base_url=url,
            headers={"Authorization": f"Bearer {key}"} if key else {},
            timeout=_TIMEOUT_S,
            limits=httpx.Limits(max_connections=None),
            transport=transport,
        )
        self._scene = scene
        self._model = ""
        self._sessions: list[str] = []

    async def __aenter__(self) -> HttpTarget:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._http.aclose()

    async def system(self) -> dict[str, Any]:
        """``/v1/system``."""
        return dict(_good(await self._http.get("/v1/system")).json())

    async def begin(self, particles: int, seed: int) -> str:
        """A session with all joints free that knows its sky."""
        if not self._model:
            files = {"file": (self._scene.file_name, self._scene.mesh)}
            self._model = _good(await self._http.post("/v1/models", files=files)).json()["model_id"]
        body = {
            "model_id": self._model,
            "name": "bench load",
            "joints": {"free": list(self._scene.joints)},
            "filter": {"particles": particles, "seed": seed},
            "light": {"sun": self._scene.towards_sun or "auto"},
        }
        session = str(_good(await self._http.post("/v1/sessions", json=body)).json()["session_id"])
        self._sessions.append(session)
        for image in self._scene.backgrounds:
            path = f"/v1/sessions/{session}/background"
            _good(await self._http.post(path, content=image, headers=_PNG))
        return session

    async def frame(self, session: str, index: int) -> Answer:
        """``PUT`` of one frame, its index chosen here: exactly once, whatever happens on the way."""
        path = f"/v1/sessions/{session}/frames/{index}"
        answer = await self._http.put(path, content=self._scene.frame(index), headers=_PNG)
        if answer.status_code not in _LATER:
            _good(answer)
        request = answer.request
        sent = _head_bytes(request.headers) + len(request.method) + len(request.url.raw_path) + len(request.content)
        return Answer(answer.is_success, sent, _head_bytes(answer.headers) + len(answer.content))

    async def end(self) -> None:
        """Delete the sessions that were begun: a running service keeps nothing of a benchmark but the mesh."""
        while self._sessions:
            _good(await self._http.delete(f"/v1/sessions/{self._sessions.pop()}"))


def _head_bytes(headers: httpx.Headers) -> int:
    return sum(len(name) + len(value) + 4 for name, value in headers.raw)


def _good(answer: httpx.Response) -> httpx.Response:
    if answer.is_error:
        raise LoadError(f"{answer.request.method} {answer.request.url.path}: {answer.status_code} {answer.text[:300]}")
    return answer
