"""The stream over a WebSocket, for both clients: addresses, and what a failed connection means."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import httpx
from websockets.exceptions import InvalidHandshake, InvalidStatus, WebSocketException

LARGEST_MESSAGE = 1 << 24
HANDSHAKE_S = 30.0
Broken = (WebSocketException, OSError, TimeoutError)
"""What ends a connection that can be made again."""


def socket_url(base_url: httpx.URL, session_id: str, query: str) -> str:
    """``ws://`` address of a session's stream."""
    scheme = "wss" if base_url.scheme == "https" else "ws"
    path = base_url.path.rstrip("/") + f"/v1/sessions/{session_id}/stream"
    return str(base_url.copy_with(scheme=scheme, path=path, query=query.encode()))


def socket_options(headers: Mapping[str, str]) -> dict[str, Any]:
    """Of either ``connect`` of websockets. The service's heartbeats tell whether it lives: no pings are needed."""
    key = headers.get("Authorization")
    return {
        "additional_headers": {} if key is None else {"Authorization": key},
        "user_agent_header": headers.get("User-Agent"),
        "max_size": LARGEST_MESSAGE,
        "open_timeout": HANDSHAKE_S,
        "ping_interval": None,
        "proxy": None,
    }


def as_transport_error(error: Exception) -> httpx.TransportError:
    """A broken WebSocket in the words of httpx, so that a client's user has one family of errors to know."""
    kind = httpx.ConnectError if isinstance(error, InvalidHandshake | OSError) else httpx.ReadError
    return kind(f"WebSocket: {type(error).__name__}: {error}")


def denial(error: Exception) -> httpx.Response | None:
    """The HTTP answer with which the service refused a handshake, or None."""
    if not isinstance(error, InvalidStatus):
        return None
    answer = error.response
    headers = [(name, value) for name, value in answer.headers.raw_items() if name.lower() != "content-encoding"]
    return httpx.Response(answer.status_code, headers=headers, content=bytes(answer.body or b""))
