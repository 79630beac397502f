"""What processes on one database tell each other, and the lock under which they share rows. SQLite needs neither.

A signal is sent by the transaction that makes it true: it is heard after the commit, or never. That a log has grown is
told beside the transactions (``teller``), because it is told so often. A signal is a hint only; the rows are the truth,
and whoever may have missed a signal reads them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import orjson
from sqlalchemy import Connection, text

CHANNEL = "skypose"
SENDER = "skypose_sender"
"""Execution option of an engine: who sends."""
ALONE = 0x534B_5902

Kind = Literal["grown", "replaced", "deleted", "revoked"]


@dataclass(frozen=True)
class Signal:
    """``grown``: a session's log, up to event ``number``. ``replaced``, ``deleted``: a session. ``revoked``: a key."""

    kind: Kind
    key: str
    number: int = 0


Heard = Callable[[Signal], None]


def send(connection: Connection, signal: Signal) -> None:
    """Tell the other processes once this transaction is committed."""
    if connection.dialect.name != "postgresql":
        return
    said = payload(connection.get_execution_options()[SENDER], signal)
    connection.execute(text("SELECT pg_notify(:channel, :payload)"), {"channel": CHANNEL, "payload": said})


def payload(sender: str, signal: Signal) -> str:
    """A signal as it is sent."""
    return orjson.dumps([sender, signal.kind, signal.key, signal.number]).decode()


def received(payload: str) -> tuple[str, Signal] | None:
    """Sender and signal; None of another release's."""
    sender, kind, key, number = orjson.loads(payload)
    return (sender, Signal(kind, key, number)) if kind in get_args(Kind) else None


def alone(connection: Connection) -> None:
    """Wait for, and keep out, every other transaction that calls this, until this one ends."""
    if connection.dialect.name == "postgresql":
        connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": ALONE})
