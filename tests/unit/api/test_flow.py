"""Places and patience of calls, without a server: a clock that only bodies turn, and calls that end when told to."""

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest
from starlette.types import Message

from service.api import flow
from service.api.flow import PROBES, Flow
from service.errors import SlowBodyError
from service.metrics import Metrics
from service.settings import Settings

pytestmark = pytest.mark.anyio
MINUTE = 6


class Body:
    """Pieces of so many bytes, each after ten seconds; then silence. It is the clock too."""

    def __init__(self, sizes: list[int]) -> None:
        self._sizes = iter(sizes)
        self.now = 0.0

    def monotonic(self) -> float:
        return self.now

    async def receive(self) -> Message:
        size = next(self._sizes, None)
        if size is None:
            await asyncio.Event().wait()
        await asyncio.sleep(0)  # as a connection does: whoever has no patience left is told here
        self.now += 10.0
        return {"type": "http.request", "body": bytes(size or 0), "more_body": True}


async def refused(monkeypatch: pytest.MonkeyPatch, body: Body, **settings: Any) -> tuple[float, dict[str, Any]]:
    """When a body is given up, and what is said."""

    async def read(scope: Any, receive: Any, send: Any) -> None:
        while True:
            await receive()

    monkeypatch.setattr(flow, "time", body)
    scope = {"type": "http", "method": "POST", "path": "/v1/sessions", "headers": []}
    with pytest.raises(SlowBodyError) as error:
        await Flow(read, Settings(**settings))(scope, body.receive, body.receive)
    return body.now, error.value.facts


async def test_a_trickle_has_an_end(monkeypatch):
    """A byte in ten seconds is never silent for long."""
    at, facts = await refused(monkeypatch, Body([1] * MINUTE), body_kb_per_s=0.001)
    assert (at, facts["setting"], facts["limit"]) == (40.0, "SKYPOSE_BODY_KB_PER_S", 0.001)


async def test_a_slow_link_is_none(monkeypatch):
    at, facts = await refused(monkeypatch, Body([10 << 10] * 10 * MINUTE), body_timeout_s=0.01)
    assert (at, facts["setting"]) == (600.0, "SKYPOSE_BODY_TIMEOUT_S")
    at, facts = await refused(monkeypatch, Body([1] * MINUTE), body_timeout_s=0.01, body_kb_per_s=0)
    assert (at, facts["setting"]) == (60.0, "SKYPOSE_BODY_TIMEOUT_S")


async def test_calls_that_need_no_key_take_no_place_of_others():
    """Files of the page have places of their own, probes need none, and a call has one once it is known who calls."""
    services = SimpleNamespace(metrics=Metrics())
    ended, begun, said = asyncio.Event(), [], []

    async def wait(scope: Any, receive: Any, send: Any) -> None:
        begun.append(scope["path"])
        await ended.wait()

    async def send(message: Message) -> None:
        said.append(message)

    def call(path: str) -> asyncio.Task[None]:
        scope = {"type": "http", "method": "GET", "path": path, "headers": []}
        app = SimpleNamespace(state=SimpleNamespace(services=services))
        return asyncio.create_task(limited({**scope, "app": app}, send, send))  # type: ignore[arg-type]

    limited = Flow(wait, Settings(max_page_files=2, max_calls=1))
    paths = ["/static/page.js", "/docs", *PROBES, *["/v1/me"] * 5]
    calls = [call(path) for path in paths]
    await call("/")
    assert said[0]["status"] == 503
    assert b"SKYPOSE_MAX_PAGE_FILES" in said[1]["body"]
    assert begun == paths
    ended.set()
    await asyncio.gather(*calls, call("/"))
    assert begun[-1] == "/"
