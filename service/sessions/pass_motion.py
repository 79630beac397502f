"""How the object of a session turned: the store's beliefs and cameras through the worker's estimator."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

import numpy as np
import orjson

from service.attitude.held import held_frames
from service.attitude.orbit import Orbit
from service.errors import ConflictError
from service.inference.params import SessionConfig
from service.inference.state import Array
from service.sessions import config as session_config
from service.sessions.absolute import absolute_camera, mount_of
from service.sessions.contenders import model_of
from service.sessions.library import articulation_of, twins_of
from service.sessions.motion_document import motion_document
from service.store import frames, models, sessions
from service.store.base import ModelRecord, SessionRecord, StoredBelief
from service.store.database import Database
from service.store.scope import SessionKey, model_key, public_id
from service.workers.base import MotionJob
from service.workers.engine import Engine

KEPT = 32  # answers of some kilobytes
_Stand = tuple[tuple[str, int, int], ...]  # sessions as they were at some frame
_UNSEEN = ("no_target", "no_fit", "lost")  # frames that say nothing of the object's rotation


@dataclass(frozen=True)
class _Facts:
    """What is needed of a stored estimate beside its belief."""

    time: str
    counts: bool
    camera: Array | None  # (4,) camera -> GCRF, towards where in the image the object was
    model: str | None
    fits: float  # probability that the truth is among the modes


class PassMotions:
    """Answers, each kept until the session's next frame."""

    def __init__(self, database: Database, engine: Engine) -> None:
        self._database = database
        self._engine = engine
        self._kept: OrderedDict[_Stand, bytes] = OrderedDict()
        self._under_way: dict[_Stand, asyncio.Task[bytes]] = {}

    async def of(self, *session_ids: SessionKey) -> bytes:
        """The motion as JSON; of several sessions, as one body that all of them saw.

        Raises ``NotFoundError``, and ``ConflictError`` for too few frames, or for sessions that cannot be told in one.
        """
        records = [await self._database.read(sessions.get, one) for one in session_ids]
        key = tuple((record.id, record.number, record.next_index) for record in records)
        if key not in self._kept:
            if key not in self._under_way:  # who asks meanwhile waits for the same
                task = self._under_way[key] = asyncio.create_task(self._find(key, records))
                task.add_done_callback(lambda one: one.cancelled() or one.exception())  # should nobody wait any more
            return await asyncio.shield(self._under_way[key])
        self._kept.move_to_end(key)
        return self._kept[key]

    async def _find(self, key: _Stand, records: Sequence[SessionRecord]) -> bytes:
        try:
            answer = self._kept[key] = await self._found(records)
        finally:
            del self._under_way[key]
        if len(self._kept) > KEPT:
            self._kept.popitem(last=False)
        return answer

    async def _found(self, records: Sequence[SessionRecord]) -> bytes:
        every = [await self._seen(record) for record in records]
        seen = [one for one in every if one.facts]
        if not seen:
            raise ConflictError("no frame was tracked yet", frames=0)
        job = await asyncio.to_thread(_job_of_all, seen)
        found = await self._engine.motion(seen[0].record.tenant, job, self._blob)
        answer = motion_document(
            public_id(records[0].id),
            found,
            sum(record.next_index for record in records),
            seen[0].zero + timedelta(seconds=found.reference_s),
            absolute=job.cameras is not None,
            among=max((one.fits for part in seen for one in part.facts if one.counts), default=1.0),
        )
        return orjson.dumps(answer)

    async def _seen(self, record: SessionRecord) -> _Seen:
        stored = await self._database.read(frames.belief_page, record.id, 0)
        documents = await self._database.read(frames.estimate_page, record.id, -1, record.next_index)
        facts = await asyncio.to_thread(lambda: [_facts(document) for _, document in documents])
        named = facts[-1].model if facts else None  # where models are compared, the one that leads now
        key = record.model_id if named is None else model_key(record.tenant, named)
        return _Seen(record, await self._database.read(models.get, key), stored, facts)

    async def _blob(self, key: str) -> bytes:
        return await self._database.read(models.get_blob, key)


def _facts(document: bytes) -> _Facts:
    estimate = orjson.loads(document)
    counts, told = estimate["status"] not in _UNSEEN, estimate.get("probabilities")
    fits = 1.0 if told is None else float(told["fits"])  # the published filter tells none
    return _Facts(estimate["time"], counts, absolute_camera(estimate), model_of(estimate), fits)


@dataclass(frozen=True)
class _Seen:
    """What one session has of an object."""

    record: SessionRecord
    model: ModelRecord
    stored: Sequence[StoredBelief]
    facts: Sequence[_Facts]

    @property
    def zero(self) -> datetime:
        """The moment from which its beliefs' times count."""
        return datetime.fromisoformat(self.facts[0].time) - timedelta(seconds=self.stored[0].time_s)


def _job_of_all(seen: Sequence[_Seen]) -> MotionJob:
    """Raises ``ConflictError`` for sessions that cannot be told in one."""
    jobs = [_job(one) for one in seen]
    if len(jobs) == 1:
        return jobs[0]
    for one, job in zip(seen, jobs, strict=True):
        session = public_id(one.record.id)
        if job.model != jobs[0].model:
            raise ConflictError("sessions of one object have one model: its axes are the body's", session=session)
        if job.cameras is None:
            detail = "sessions are told in one where the camera's orientation is known in every frame"
            raise ConflictError(detail, session=session)
    shifted = [
        replace(job, offset_s=(one.zero - seen[0].zero).total_seconds()) for one, job in zip(seen, jobs, strict=True)
    ]
    return replace(shifted[0], others=tuple(shifted[1:]))


def _job(seen: _Seen) -> MotionJob:
    record, model, stored, facts = seen.record, seen.model, seen.stored, seen.facts
    info, config = record.background_info or {}, session_config.stored(record.config)
    counts = tuple(one.counts and one.model == facts[-1].model for one in facts)
    known = all(one.camera is not None for one, used in zip(facts, counts, strict=True) if used)
    nowhere = np.array([1.0, 0.0, 0.0, 0.0])
    return MotionJob(
        config=config,
        model=model.blob_key,
        file_type=model.file_type,
        articulation=articulation_of(model),
        twins=twins_of(model),
        width=int(info["width"]),
        height=int(info["height"]),
        beliefs=tuple(row.belief for row in stored),
        references=_references(config, facts) if known else None,
        counts=counts,
        cameras=tuple(nowhere if one.camera is None else one.camera for one in facts) if known else None,
    )


def _references(config: SessionConfig, facts: Sequence[_Facts]) -> dict[str, Array] | None:
    """(frames, 3, 3) of the frames that the object may be held in; None where its orbit was not told."""
    site = mount_of(config.camera).site
    if config.prior.orbit is None or site is None:
        return None
    return held_frames(Orbit(config.prior.orbit), site, [datetime.fromisoformat(one.time) for one in facts])
