"""Checkpoints: a session as one portable blob, to move it between servers or to keep it.

Holds the model's file, the configuration, the background, the newest particles and every estimate, so that the
other server answers repeated frames as this one would. It comes from outside: everything in it is checked, the
model is prepared anew.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Sequence
from dataclasses import dataclass, fields
from hashlib import sha256
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from service.errors import CheckpointError, InputError
from service.sessions import config as session_config
from service.sessions.archive import session_document
from service.sessions.checkpoint_check import (
    EstimateCheck,
    History,
    check_estimates,
    check_history,
    read_header,
    read_history,
    require_restored,
)
from service.sessions.checkpoint_models import (
    Compared,
    check_ranking,
    model_row,
    pack_models,
    unpack_models,
    uploads_of,
)
from service.sessions.document import JointNames
from service.sessions.library import Library, Upload, articulation_of, content_id
from service.sessions.registry import Registry
from service.store import checkpoints
from service.store.base import ModelRecord, SessionRecord
from service.store.checkpoints import StoredSession
from service.store.database import Database
from service.store.scope import SessionKey, model_key, public_id, session_key
from service.workers.base import RestoreJob
from service.workers.codec import decode, encode
from service.workers.engine import Engine

SESSION_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")
_NOT_CARRIED = ("id", "epoch", "number", "model_ids", "tenant", "model_id", "ended_at")
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
    compared: Compared | None = None  # of a session that compares models; ``model_file`` is then empty


class Checkpoints:
    """Writes and reads them."""

    def __init__(
        self,
        database: Database,
        registry: Registry,
        library: Library,
        engine: Engine,
        check_estimate: EstimateCheck,
    ) -> None:
        self._database = database
        self._engine = engine
        self._check_estimate = check_estimate
        self._registry = registry
        self._library = library

    async def get(self, session_id: SessionKey) -> bytes:
        """The session as it stands. Raises ``NotFoundError``."""
        stored = await self._database.read(checkpoints.read, session_id)
        return await asyncio.to_thread(pack, stored)

    async def put(self, tenant: str, session_id: str, blob: bytes) -> tuple[dict[str, Any], bool]:
        """Take a session in, as the tenant's. Returns it, and whether it is new here.

        Raises ``CheckpointError``, or ``ConflictError`` where a session of that id is here and is not an earlier
        stand of this one.
        """
        if not SESSION_ID.fullmatch(session_id):
            raise InputError("a session id has 1 to 64 letters, digits, - or _", field="session_id")
        packed = await asyncio.to_thread(decode, Checkpoint, blob)
        uploads = [_upload(packed)] if packed.compared is None else uploads_of(packed.compared)
        models = [await self._prepare(tenant, upload) for upload in uploads]
        key = session_key(tenant, session_id)
        given, jobs = await asyncio.to_thread(unpack, packed, key, models, self._check_estimate)
        for job in jobs:
            require_restored(given.record, await self._engine.restore(tenant, job), leads=job is jobs[0])
        new = await self._registry.take_in(given)
        return session_document(given.record), new

    async def _prepare(self, tenant: str, upload: Upload) -> ModelRecord:
        key = model_key(tenant, await asyncio.to_thread(content_id, upload))
        return await self._library.prepare(tenant, key, upload)


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
            model=_json(model_row(model)),
            model_file=_array(b"" if stored.compared else stored.model_file),
            background=_array(stored.background or b""),
            state=_array(stored.state or b""),
            history=_json(history),
            compared=pack_models(stored),
        )
    )


def unpack(
    packed: Checkpoint, key: SessionKey, models: Sequence[ModelRecord], check_estimate: EstimateCheck
) -> tuple[StoredSession, list[RestoreJob]]:
    """A checkpoint as a session to store, under this key, and the jobs that check its background and particles.

    The first job is of the particles that the session shows; one for each further model follows. Raises
    ``CheckpointError`` for what does not fit.
    """
    try:
        given = read_header(packed.session.tobytes())
        given["config"] = session_config.document(session_config.stored(given["config"]))  # every section
        history = read_history(packed.history.tobytes())
        model = models[0]
        compared = () if packed.compared is None else unpack_models(packed.compared, models)
        record = SessionRecord(
            id=key,
            model_ids=tuple(one.model.id for one in compared),
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
            model_file=compared[0].file if compared else packed.model_file.tobytes(),
            background=packed.background.tobytes() or None,
            state=packed.state.tobytes() or None,
            backgrounds=[dict(row) for row in history["backgrounds"]],
            frames=[dict(row) for row in history["frames"]],
            estimates=estimates,
            events=[dict(row) for row in history["events"]],
            compared=compared,
        )
        return stored, _checked(stored, history, check_estimate)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise CheckpointError(f"the content does not fit: {error}", field="body") from error


def _checked(stored: StoredSession, history: History, check_estimate: EstimateCheck) -> list[RestoreJob]:
    record, newest = stored.record, history["estimates"][-1]["document"] if history["estimates"] else None
    config = session_config.stored(record.config)
    names = {}
    for model in [one.model for one in stored.compared] or [stored.model]:
        articulation = articulation_of(model)
        session_config.check_joints(config, articulation)
        names[public_id(model.id)] = JointNames.of(articulation, config)
    check_history(record, history)
    check_estimates(history, names, check_estimate)
    if stored.compared:
        check_ranking(stored.compared, newest, stored.state)
    if record.background_key != (None if stored.background is None else sha256(stored.background).hexdigest()):
        raise ValueError("the background is missing, or another one")
    if (stored.state is None) != (record.next_index == 0) or (record.next_index and stored.background is None):
        raise ValueError("particles or background are missing, or there without frames")
    info = record.background_info
    if (info is None) != (stored.background is None):
        raise ValueError("the background is not described")
    size = None if info is None else (info["width"], info["height"])
    shown = public_id(stored.model.id) if newest is None or not stored.compared else newest["models"][0]["model_id"]
    states = {public_id(one.model.id): one.contender.state for one in stored.compared if one.contender.state}
    jobs = {name: RestoreJob(config, stored.background, size, states[name], len(names[name].free)) for name in states}
    jobs[shown] = RestoreJob(config, stored.background, size, stored.state, len(names[shown].free))
    return [jobs.pop(shown), *jobs.values()]


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
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise CheckpointError(f"the model does not fit: {error}") from error


def _json(value: object) -> Bytes:
    return _array(orjson.dumps(value))


def _array(data: bytes) -> Bytes:
    return np.frombuffer(data, np.uint8)
