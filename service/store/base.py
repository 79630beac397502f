"""What the store takes and gives: plain records."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from service.store.scope import DEFAULT_TENANT, ModelKey, ObjectKey, SessionKey

Record = TypeVar("Record")


@dataclass(frozen=True)
class Page(Generic[Record]):
    """Rows in order of creation, and the cursor of the next page or None.

    ``damaged``: ids of rows that are not as they were stored; they are left out.
    """

    records: tuple[Record, ...]
    damaged: tuple[str, ...]
    cursor: int | None


@dataclass(frozen=True)
class ModelRecord:
    """An uploaded model. ``report`` is what was found in it, ``joints`` what the client gave; JSON data."""

    id: ModelKey
    name: str
    file_type: str
    blob_key: str
    report: Mapping[str, Any]
    created_at: str
    joints: tuple[Mapping[str, Any], ...] | None = None
    number: int = 0  # order of creation, given by the store
    tenant: str = DEFAULT_TENANT


@dataclass(frozen=True)
class SessionRecord:
    """A session as the database holds it."""

    id: SessionKey
    model_id: ModelKey
    name: str | None
    config: Mapping[str, Any]
    warnings: tuple[str, ...]
    created_at: str
    updated_at: str
    epoch: int = 0  # raised whenever an owner takes the session; older owners can then write no more
    next_index: int = 0
    next_seq: int = 1
    status: str | None = None  # of the last estimate
    time_s: float | None = None  # of the last frame, since the first one
    time_given: str | None = None  # the client's time of the last frame, if it brought one
    background_key: str | None = None
    background_frames: int = 0
    background_info: Mapping[str, Any] | None = None
    number: int = 0
    ended_at: str | None = None  # it takes no more frames since
    model_ids: tuple[ModelKey, ...] = ()  # of a session that compares models, ``model_id`` the first; else none
    tenant: str = DEFAULT_TENANT


@dataclass(frozen=True)
class SessionStamp:
    """When a session was last used, and when it ended."""

    id: SessionKey
    updated_at: str
    ended_at: str | None


@dataclass(frozen=True)
class ObjectRecord:
    """An object, and the sessions that are of it in the order of their creation."""

    id: ObjectKey
    name: str
    created_at: str
    number: int = 0
    tenant: str = DEFAULT_TENANT
    sessions: tuple[SessionKey, ...] = ()


@dataclass(frozen=True)
class StoredContender:
    """A model that a session compares, after the newest frame."""

    model_id: ModelKey
    state: bytes | None
    log_evidence: float


@dataclass(frozen=True)
class FrameRecord:
    """A tracked frame with all that its one transaction holds."""

    session_id: SessionKey
    epoch: int
    index: int
    sha256: str
    idempotency_key: str | None
    media_type: str
    time: str
    time_given: str | None
    time_s: float
    query: Mapping[str, Any]
    body: bytes
    status: str
    document: bytes  # the estimate as the API answers it
    state: bytes  # the weighted particles, packed
    created_at: str
    belief: bytes | None = None  # their modes, packed, kept for good; None: nothing is known
    contenders: tuple[StoredContender, ...] = ()  # of a session that compares models, in its order


@dataclass(frozen=True)
class StoredFrame:
    """What tells a repeated frame from a new one."""

    index: int
    sha256: str
    idempotency_key: str | None


@dataclass(frozen=True)
class BackgroundRecord:
    """A background after one more image."""

    session_id: SessionKey
    epoch: int
    sha256: str
    idempotency_key: str | None
    key: str
    data: bytes
    frames: int
    info: Mapping[str, Any]
    created_at: str


@dataclass(frozen=True)
class Retention:
    """What of the past is kept beside the estimates, which are kept for good."""

    frame_bodies: int
    particle_sets: int
    particle_every: int


@dataclass(frozen=True)
class Quotas:
    """How much one tenant may have; 0: any number."""

    sessions: int = 0
    models: int = 0
    particles: int = 0  # of all its sessions together


NO_QUOTAS = Quotas()


@dataclass(frozen=True)
class StoredBelief:
    """What the smoother needs of a frame."""

    index: int
    time_s: float
    belief: bytes | None


@dataclass(frozen=True)
class StoredEvent:
    """An entry of a session's event log."""

    seq: int
    document: bytes


@dataclass(frozen=True)
class KeyRecord:
    """An API key as the database holds it: its secret only as a hash."""

    id: str
    sha256: str
    tenant: str
    role: str
    name: str
    created_at: str
    expires_at: str | None = None
    revoked_at: str | None = None
    last_used_at: str | None = None
    rates: Mapping[str, float] | None = None  # its own, by name; None: those of the settings
    number: int = 0


@dataclass(frozen=True)
class AuditRecord:
    """Who did what, when, and how it ended (an HTTP status); ``count`` times since ``at``."""

    at: str
    tenant: str
    actor: str
    address: str
    action: str
    target: str
    outcome: int
    count: int = 1
    request_id: str = ""
    number: int = 0


@dataclass(frozen=True)
class TicketRecord:
    """A ticket as the database holds it: only its hash, and in whose name it reads."""

    digest: str
    tenant: str
    key_id: str
    expires: str | None  # of the credential it was got with
