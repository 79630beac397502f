"""Checkpoints: a session as one portable blob, to move it between servers or to keep it.

Holds the model's file, the configuration, the background, the newest particles and every estimate, so that the
other server answers repeated frames as this one would. It comes from outside: everything in it is checked, the
model is prepared anew.
"""

from __future__ import annotations

import asyncio
import hashlib
import re
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from service.errors import CheckpointError, InputError
from service.inference.state import STATUSES, FilterState
from service.sessions import config as session_config
from service.sessions.archive import session_document
from service.sessions.contenders import require_one_model
from service.sessions.document import JointNames
from service.sessions.library import Library, Upload, articulation_of, content_id
from service.sessions.registry import Registry
from service.store import checkpoints
from service.store.base import ModelRecord, SessionRecord
from service.store.checkpoints import StoredSession
from service.store.database import Database
from service.store.scope import SessionKey, model_key, public_id, session_key
from service.workers.codec import decode, encode

SESSION_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")
_NOT_CARRIED = ("id", "epoch", "number", "model_ids", "tenant", "model_id")
Bytes = NDArray[np.uint8]


@dataclass(frozen=True)
class Checkpoint:
    """What is in the blob (``service.workers.codec``); texts are JSON."""

    session: Bytes
    model: Bytes
    model_file: Bytes
    background: Bytes
    state: Bytes
    history: Bytes


class Checkpoints:
    """Writes and reads them."""

    def __init__(self, database: Database, registry: Registry, library: Library) -> None:
        self._database = database
        self._registry = registry
        self._library = library

    async def get(self, session_id: SessionKey) -> bytes:
        """The session as it stands. Raises ``NotFoundError``."""
        stored = await self._database.read(checkpoints.read, session_id)
        require_one_model(stored.record, "checkpoint")
        return await asyncio.to_thread(pack, stored)

    async def put(self, tenant: str, session_id: str, blob: bytes) -> tuple[dict[str, Any], bool]:
        """Take a session in, as the tenant's. Returns it, and whether it is new here.

        Raises ``CheckpointError``, or ``ConflictError`` where a session of that id is here and is not an earlier
        stand of this one.
        """
        if not SESSION_ID.fullmatch(session_id):
            raise InputError("a session id has 1 to 64 letters, digits, - or _", field="session_id")
        packed = await asyncio.to_thread(decode, Checkpoint, blob)
        upload = await asyncio.to_thread(_upload, packed)
        model = await self._library.prepare(tenant, model_key(tenant, content_id(upload)), upload)
        key = session_key(tenant, session_id)
        given = await asyncio.to_thread(unpack, packed, key, model)
        new = await self._registry.take_in(given)
        return session_document(given.record), new


def pack(stored: StoredSession) -> bytes:
    """A stored session as a checkpoint."""
    record, model = stored.record, stored.model
    session = {f.name: getattr(record, f.name) for f in fields(record) if f.name not in _NOT_CARRIED}
    history = {
        "backgrounds": stored.backgrounds,
        "frames": stored.frames,
        "events": stored.events,
        "estimates": [{**row, "document": orjson.Fragment(row["document"])} for row in stored.estimates],
    }
    return encode(
        Checkpoint(
            session=_json(session),
            model=_json({"name": model.name, "file_type": model.file_type, "joints": model.joints}),
            model_file=_array(stored.model_file),
            background=_array(stored.background or b""),
            state=_array(stored.state or b""),
            history=_json(history),
        )
    )


def unpack(packed: Checkpoint, key: SessionKey, model: ModelRecord) -> StoredSession:
    """A checkpoint as a session to store, under this key. Raises ``CheckpointError`` for what does not fit."""
    try:
        session = orjson.loads(packed.session.tobytes())
        history = orjson.loads(packed.history.tobytes())
        carried = {f.name for f in fields(SessionRecord)} - set(_NOT_CARRIED)
        given = {name: value for name, value in session.items() if name != "model_id"}  # which older releases wrote
        if given.keys() - carried:  # a crafted one could otherwise name rows of others
            raise ValueError(f"unknown fields {sorted(given.keys() - carried)}")
        record = SessionRecord(
            id=key,
            tenant=model.tenant,
            model_id=model.id,
            **{**given, "warnings": tuple(given["warnings"])},
        )
        estimates = [
            {**row, "document": orjson.dumps({**row["document"], "session_id": public_id(key)})}
            for row in history["estimates"]
        ]
        stored = StoredSession(
            record=record,
            model=model,
            model_file=packed.model_file.tobytes(),
            background=packed.background.tobytes() or None,
            state=packed.state.tobytes() or None,
            backgrounds=history["backgrounds"],
            frames=history["frames"],
            estimates=estimates,
            events=history["events"],
        )
        _check(stored)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise CheckpointError(f"the content does not fit: {error}") from error
    return stored


def _check(stored: StoredSession) -> None:
    record = stored.record
    config = session_config.parse(orjson.dumps(record.config))
    articulation = articulation_of(stored.model)
    session_config.check_joints(config, articulation)
    indexes = list(range(record.next_index))
    for rows in (stored.frames, stored.estimates, stored.events):
        if [row["idx"] for row in rows] != indexes:
            raise ValueError("the history has gaps")
    if record.next_seq != record.next_index + 1:
        raise ValueError("the event log has gaps")
    if record.background_key != (None if stored.background is None else hashlib.sha256(stored.background).hexdigest()):
        raise ValueError("the background is missing, or another one")
    if stored.state is not None:
        _check_state(decode(FilterState, stored.state), len(JointNames.of(articulation, config).free))
    elif record.next_index:
        raise ValueError("the particles are missing")


def _check_state(state: FilterState, n_joints: int) -> None:
    poses, n = state.poses, len(state.log_weights)
    shapes = {
        "quaternion": (poses.quaternion, (n, 4)),
        "position": (poses.position, (n, 2)),
        "log_scale": (poses.log_scale, (n,)),
        "joints": (poses.joints, (n, n_joints)),
        "log_weights": (state.log_weights, (n,)),
        "rates": (state.rates, (n, 6 + n_joints)),
    }
    for name, (array, shape) in shapes.items():
        if array.shape != shape or array.dtype != np.float64 or n < 1:
            raise ValueError(f"{name} is {array.dtype} {array.shape}, not float64 {shape}")
        finite = np.isfinite(array) | (np.isneginf(array) if name == "log_weights" else False)
        if not finite.all():
            raise ValueError(f"{name} is not finite")
    if state.status not in STATUSES:
        raise ValueError(f"status {state.status!r}")


def _upload(packed: Checkpoint) -> Upload:
    try:
        model = orjson.loads(packed.model.tobytes())
        joints = model["joints"]
        return Upload(
            data=packed.model_file.tobytes(),
            file_type=str(model["file_type"]),
            name=str(model["name"])[:200],
            joints=None if joints is None else tuple(joints),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise CheckpointError(f"the model does not fit: {error}") from error


def _json(value: object) -> Bytes:
    return _array(orjson.dumps(value))


def _array(data: bytes) -> Bytes:
    return np.frombuffer(data, np.uint8)
