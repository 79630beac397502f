"""Calls that belong to the process that has the session: answered here where that is this one, else handed on to it.

Access was decided where the call came in; the owner believes its peers' signature, and hands nothing on again. A call
is handed on until an owner answers it: frames carry an index or a key by then, so that no try can apply one twice.
"""

from __future__ import annotations

import asyncio
import time
import uuid
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import orjson
import structlog
from starlette.requests import HTTPConnection, Request
from starlette.responses import Response, StreamingResponse

from service.access.peers import FORWARDED, HEADER, PEER_FIELD, Peers
from service.access.principal import Principal, SessionKey
from service.api.digest import sha256
from service.api.problems import NDJSON, problem_line, problem_type
from service.errors import SkyposeError, StaleOwnerError, StoppingError, UnauthorizedError
from service.metrics import Metrics
from service.sessions.cluster import Cluster, Instance
from service.sessions.registry import Registry
from service.sessions.session import Session

if TYPE_CHECKING:
    import httpx

log = structlog.get_logger(__name__)
_GONE_AFTER_S = 0.3  # nobody listens at the owner's address for so long: it is dead, whatever its lease says
_PAUSE_S = 0.03
_CONNECT_S = 2.0
_LAST_WORDS_S = 0.5  # an owner that gave the session up may be answering just now
_SENT_ON = ("content-type", "prefer", "idempotency-key", "x-request-id")
_SENT_BACK = ("content-location", "location", "retry-after", "preference-applied")
_ELSEWHERE = {problem_type(StaleOwnerError), problem_type(StoppingError)}


@dataclass
class Call:
    """A call for the owner of a session. ``target`` is path and query as the owner gets them."""

    session: SessionKey
    caller: Principal
    method: str
    target: str
    body: bytes
    headers: dict[str, str]
    forwarded: bool
    refused_since: dict[str, float] = field(default_factory=dict)  # instance -> when nobody listened there first

    @classmethod
    def of(
        cls, request: Request, session: SessionKey, caller: Principal, body: bytes = b"", key: str | None = None
    ) -> Call:
        """This request, under an idempotency key where it has none of its own."""
        headers = {name: request.headers[name] for name in _SENT_ON if name in request.headers}
        if key is not None:
            headers["idempotency-key"] = key
        forwarded = bool(request.scope.get("state", {}).get(FORWARDED, False))
        return cls(session, caller, request.method, target_of(request), body, headers, forwarded)


def target_of(connection: HTTPConnection) -> str:
    """Path and query of a call, as they came."""
    path, query = connection.scope["raw_path"].decode("latin-1"), connection.scope["query_string"].decode("latin-1")
    return f"{path}?{query}" if query else path


class Forwarding:
    """Finds the owner of a session for each call. ``cluster`` is None where this process is alone."""

    def __init__(
        self, registry: Registry, metrics: Metrics, cluster: Cluster | None, peers: Peers | None, patience_s: float
    ) -> None:
        self.cluster = cluster
        self.peers = peers
        self._registry = registry
        self._metrics = metrics
        self._patience_s = patience_s
        self._http: httpx.AsyncClient | None = None

    async def open(self) -> None:
        """Be ready to hand calls on."""
        if self.peers is not None:
            import httpx  # here and below: one process alone never needs it

            await self.peers.open()
            limits = httpx.Limits(max_connections=None, max_keepalive_connections=100, keepalive_expiry=2.0)
            timeout = httpx.Timeout(None, connect=_CONNECT_S)  # how long an owner may take, its lease says
            self._http = httpx.AsyncClient(timeout=timeout, limits=limits, trust_env=False)

    async def close(self) -> None:
        """Let go of the connections."""
        if self._http is not None:
            await self._http.aclose()

    def key_for_retries(self) -> str | None:
        """An idempotency key for a call without one, where it may be tried more than once."""
        return None if self.cluster is None else uuid.uuid4().hex

    async def at_owner(self, call: Call, here: Callable[[Session], Awaitable[Response]]) -> Response:
        """The answer of ``here`` with the session's owner in this process, or the answer of the process that has it.

        Raises what either is refused for; ``StaleOwnerError`` where no owner stayed for long enough.
        """
        if self.cluster is None:
            return await here(await self._registry.get(call.session))
        until = time.monotonic() + self._patience_s
        while True:
            try:
                found = await self._registry.find(call.session, self._gone(call))
                if isinstance(found, Session):
                    return await here(found)
                if call.forwarded:
                    raise StaleOwnerError("another process has the session")
                return await self.hand_on(call, found)
            except StaleOwnerError:
                if call.forwarded or time.monotonic() >= until:
                    raise
            await asyncio.sleep(_PAUSE_S)

    async def at_peer(self, call: Call) -> Response | None:
        """The answer of another process that has the session; None where this one is to answer."""
        if self.cluster is None or call.forwarded:
            return None
        peer = await self._registry.peer(call.session)
        return None if peer is None else await self.hand_on(call, peer)

    async def hand_on(self, call: Call, to: Instance) -> Response:
        """The answer of another process. Raises ``StaleOwnerError`` where that is none, or not the owner's."""
        import httpx

        self._metrics.forwarded.inc()
        sending = asyncio.create_task(self._send(call, to))
        try:
            if not await self._before_lost(call.session, to, sending):
                raise StaleOwnerError("the process that had the session is no longer heard of")
            answer = sending.result()
        except httpx.ConnectError as error:
            call.refused_since.setdefault(to.id, time.monotonic())
            raise StaleOwnerError("nobody listens where the session's process was") from error
        except httpx.TransportError as error:
            raise StaleOwnerError("the process that has the session broke off") from error
        finally:
            sending.cancel()
        call.refused_since.pop(to.id, None)
        headers = {name: answer.headers[name] for name in _SENT_BACK if name in answer.headers}
        if answer.is_closed:
            _raise_if_to_ask_again(answer)
            return Response(answer.content, answer.status_code, headers, answer.headers.get("content-type"))
        return StreamingResponse(self._lines(call.session, to, answer), answer.status_code, headers, NDJSON)

    async def _send(self, call: Call, to: Instance) -> httpx.Response:
        """The answer, read to its end unless it is one that goes on while frames are tracked."""
        assert self._http is not None and self.peers is not None, "open() comes first"
        token = self.peers.sign(call.caller, to.id, call.method, call.target, await sha256(call.body))
        request = self._http.build_request(
            call.method, to.url + call.target, content=call.body, headers={**call.headers, HEADER: token}
        )
        answer = await self._http.send(request, stream=True)
        if not answer.headers.get("content-type", "").startswith(NDJSON):
            await answer.aread()
        return answer

    async def _before_lost(self, session: SessionKey, to: Instance, work: asyncio.Task[object]) -> bool:
        """Wait for the work while its process has the session. Returns whether it was done."""
        assert self.cluster is not None
        while True:
            done, _ = await asyncio.wait({work}, timeout=self.cluster.lease_s / 4)
            if done:
                return True
            owner = await self._registry.peer(session)
            if owner is None or owner.id != to.id:
                done, _ = await asyncio.wait({work}, timeout=_LAST_WORDS_S)
                return bool(done)

    async def _lines(self, session: SessionKey, to: Instance, answer: httpx.Response) -> AsyncIterator[bytes]:
        """Pieces of an answer as they come; where they stop, the last line says so."""
        import httpx

        pieces = answer.aiter_bytes()
        try:
            while True:
                work: asyncio.Task[bytes | None] = asyncio.create_task(_next(pieces))
                if not await self._before_lost(session, to, work):
                    work.cancel()
                    raise StaleOwnerError("the process that had the session is no longer heard of")
                piece = work.result()
                if piece is None:
                    return
                yield piece
        except httpx.TransportError:
            yield problem_line(StaleOwnerError("the process that has the session broke off"))
        except SkyposeError as error:
            yield problem_line(error)
        finally:
            await answer.aclose()

    def _gone(self, call: Call) -> str | None:
        """The process that is to be taken for dead."""
        for instance, since in call.refused_since.items():
            if time.monotonic() - since >= _GONE_AFTER_S:
                log.warning("nobody listens there: its session is taken", instance=instance)
                return instance
        return None


def _raise_if_to_ask_again(answer: httpx.Response) -> None:
    """Raises ``StaleOwnerError`` for what is no answer to the call: it says something of the two processes alone."""
    if answer.status_code == StaleOwnerError.status and orjson.loads(answer.content)["type"] in _ELSEWHERE:
        raise StaleOwnerError("the process that had the session gives it up")
    if answer.status_code == UnauthorizedError.status and orjson.loads(answer.content).get("field") == PEER_FIELD:
        raise StaleOwnerError("the process that has the session did not take this one's signature")


async def _next(pieces: AsyncIterator[bytes]) -> bytes | None:
    return await anext(pieces, None)
