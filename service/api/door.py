"""The connections of the web process, before there is a call: how many, from where, and what they may keep waiting.

uvicorn's two protocols with what they leave open: a head that never ends, a body that nobody wants, and handles that
run out. A connection that is not in the middle of a call gives way to a new one, so a probe always gets in.
"""

from __future__ import annotations

import asyncio
import resource
import time
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from itertools import chain, takewhile
from typing import Any, cast

import h11
import uvicorn
from fastapi import FastAPI
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware
from uvicorn.protocols.http.flow_control import CLOSE_HEADER
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from service.api.flow import PROBES
from service.api.problems import problem_response
from service.api.services import Services
from service.errors import BusyError
from service.settings import Settings

ACCEPTED_AT_ONCE = 16  # in one turn of the event loop: calls go on between, and each is counted before handles run out
LISTEN_QUEUE = 2048  # connections that the kernel keeps until then
PROBE_CONNECTIONS = 32  # beyond the limit, where only probes are answered
OWN_HANDLES = 128  # the database, pipes to the workers, files of the page
HEAD_SOON_S = 1.0  # for a new connection to say what it wants before one that was of use gives way to it
# For the next call on a connection. Longer than clients and proxies keep theirs (httpx 5 s, nginx 60 s, Caddy 120 s):
# with equal times a call is sent into a connection that ends. One that waits costs a handle, and gives way to others.
KEEP_ALIVE_S = 150
LINGER_S = 5.0  # for an answer to be read before the connection is cut; nginx waits so long (lingering_timeout)


class Link:
    """A connection's transport as its protocols see it. Closed, it neither waits for ever nor swallows the answer.

    A socket that is closed with bytes unread is reset, and the client may never see what it was answered. So where the
    rest of a body is still coming only our side ends, and that body is read and forgotten for ``LINGER_S``.
    """

    def __init__(self, transport: asyncio.Transport) -> None:
        self._transport = transport
        self._closing = False
        self.address = str((transport.get_extra_info("peername") or ("",))[0])
        self.body_unread = False
        self.counted = False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._transport, name)

    def is_closing(self) -> bool:
        """Whether what still comes is for nobody."""
        return self._closing or self._transport.is_closing()

    def close(self) -> None:
        """End it, once the client has what was written, or does not take it."""
        if self.body_unread and not self.is_closing():
            self._transport.write_eof()
            self._transport.resume_reading()
        else:
            self._transport.close()
        self._closing = True
        asyncio.get_running_loop().call_later(LINGER_S, self._transport.abort)

    def abort(self) -> None:
        """End it now."""
        self._closing = True
        self._transport.abort()


class Door:
    """Counts a server's connections. ``is_proxy``: of an address that stands for many clients."""

    def __init__(self, services: Services, is_proxy: Callable[[str], bool]) -> None:
        settings = services.settings
        self.head_timeout_s = settings.head_timeout_s
        self._metrics = services.metrics
        self._most = connection_limit(settings)
        self._most_of_address = settings.max_connections_per_address
        self._is_proxy = is_proxy
        self._open = 0
        self._of_address: Counter[str] = Counter()
        # Those not in the middle of a call, and since when, in that order: without a whole head so far, with a call
        # answered, and with the rest of a refused body.
        self._new: dict[Link, float] = {}
        self._idle: dict[Link, float] = {}
        self._ending: dict[Link, float] = {}

    @property
    def busy(self) -> int:
        """Connections in the middle of a call."""
        return self._open - len(self._new) - len(self._idle) - len(self._ending)

    def enter(self, link: Link) -> None:
        """A new connection. The one that waits longest gives way where there are too many."""
        link.counted = True
        self._open += 1
        self._of_address[link.address] += 1
        self._new[link] = time.monotonic()
        if 0 < self._most_of_address < self._of_address[link.address] and not self._is_proxy(link.address):
            self._make_room("address", link.address)
        elif self._open > self._most + PROBE_CONNECTIONS:
            self._make_room("all", None)
        self._metrics.connections.set(self._open)

    def begin(self, link: Link) -> None:
        """It has sent the head of a call."""
        self._new.pop(link, None)
        self._idle.pop(link, None)
        self._ending.pop(link, None)

    def wait(self, link: Link) -> None:
        """Its call is answered."""
        if link.counted:
            (self._ending if link.is_closing() else self._idle)[link] = time.monotonic()

    def waits(self, link: Link) -> bool:
        """Whether it is to send the head of a call."""
        return link in self._new or link in self._idle

    def leave(self, link: Link) -> None:
        """It is gone, or as good as gone."""
        if not link.counted:
            return
        link.counted = False
        self.begin(link)
        self._open -= 1
        self._of_address[link.address] -= 1
        if not self._of_address[link.address]:
            del self._of_address[link.address]
        self._metrics.connections.set(self._open)

    def cut(self, link: Link, reason: str) -> None:
        """End a connection that keeps others waiting."""
        self.leave(link)
        self._metrics.cut_connections.labels(reason).inc()
        link.abort()

    def guard(self, app: ASGIApp) -> ASGIApp:
        """The application, where there is room for more than probes."""

        async def guarded(scope: Scope, receive: Receive, send: Send) -> None:
            if self.busy <= self._most or scope["path"] in PROBES:
                await app(scope, receive, send)
                return
            error = BusyError("too many connections", limit=self._most, setting="SKYPOSE_MAX_CONNECTIONS")
            self._metrics.refusals.labels(error.slug).inc()
            await problem_response(error)(scope, receive, send)

        return guarded

    def _make_room(self, reason: str, address: str | None) -> None:
        """Cut the connection that has waited longest, of an address or any. One that was of use so far comes late."""
        soon = time.monotonic() - HEAD_SOON_S
        slow = takewhile(lambda link: self._new[link] < soon, self._new)
        for link in chain(self._ending, slow, self._idle, self._new):
            if address in (None, link.address):
                self.cut(link, reason)
                return


class HttpProtocol(H11Protocol):
    """uvicorn's, with an end to the wait for a head, and for a body whose call is answered."""

    def __init__(self, *args: Any, door: Door, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._door = door
        self._guarded = door.guard(cast(ASGIApp, self.app))
        self.app = cast(Any, self._answer)
        self._deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for the first head."""
        self._link = Link(transport)
        super().connection_made(cast(asyncio.Transport, self._link))
        self._expect_head()
        self._door.enter(self._link)

    def connection_lost(self, exc: Exception | None) -> None:
        """Be counted no longer."""
        self._head_complete()
        super().connection_lost(exc)
        self._door.leave(self._link)

    def data_received(self, data: bytes) -> None:
        """Read on, unless the rest is for nobody."""
        if self._link.is_closing():
            return
        super().data_received(data)
        if self._deadline is None and self._door.waits(self._link):  # the next head has begun
            self._expect_head()

    def handle_events(self) -> None:
        """Note where the last bytes ended a head."""
        super().handle_events()
        if self.conn.their_state is not h11.IDLE:
            self._door.begin(self._link)
            self._head_complete()

    def on_response_complete(self) -> None:
        """Wait for the next head."""
        self._door.wait(self._link)
        super().on_response_complete()

    async def _answer(self, scope: Scope, receive: Receive, send: Send) -> None:
        """An answer that does not wait for the call's body is the connection's last."""
        cycle = self.cycle

        async def marked(message: Message) -> None:
            self._link.body_unread = cycle.more_body
            if message["type"] == "http.response.start" and cycle.more_body:
                message = {**message, "headers": [*message.get("headers", ()), CLOSE_HEADER]}
            await send(message)

        await self._guarded(scope, receive, marked)

    def _expect_head(self) -> None:
        self._deadline = self.loop.call_later(self._door.head_timeout_s, self._door.cut, self._link, "head")

    def _head_complete(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None


class WatchProtocol(WebSocketsSansIOProtocol):
    """uvicorn's, counted too. It takes over a connection with the head of its handshake."""

    def __init__(self, *args: Any, door: Door, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._door = door
        self.app = cast(Any, door.guard(cast(ASGIApp, self.app)))

    def connection_lost(self, exc: Exception | None) -> None:
        """Be counted no longer."""
        super().connection_lost(exc)
        self._door.leave(cast(Link, self.transport))


def connection_limit(settings: Settings) -> int:
    """How many connections there may be in the middle of calls, and handles enough for everything else."""
    handles, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if handles == resource.RLIM_INFINITY:
        return settings.max_connections
    room = handles - OWN_HANDLES - ACCEPTED_AT_ONCE - PROBE_CONNECTIONS
    if settings.database_url.get_secret_value():
        room //= 2  # a call that is handed on to another process takes a second one
    return max(1, min(settings.max_connections, room))


def server_config(app: FastAPI, **options: Any) -> uvicorn.Config:
    """What uvicorn needs to serve the application behind this door."""
    config = uvicorn.Config(
        app,
        log_config=None,
        server_header=False,
        backlog=ACCEPTED_AT_ONCE,
        ws_max_size=1 << 16,
        timeout_keep_alive=KEEP_ALIVE_S,
        **options,
    )
    proxies = ProxyHeadersMiddleware(cast(Any, app), config.forwarded_allow_ips).trusted_hosts
    door = Door(app.state.services, lambda address: address in proxies)
    config.http = cast(Any, partial(HttpProtocol, door=door))
    config.ws = cast(Any, partial(WatchProtocol, door=door))
    return config


def deepen(listeners: Sequence[asyncio.Server]) -> None:
    """Let the kernel keep more new connections than the event loop accepts in one turn: asyncio has one number."""
    for listener in listeners:
        for shared in listener.sockets:
            with shared.dup() as again:
                again.listen(LISTEN_QUEUE)
