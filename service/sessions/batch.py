"""A body of several frames: taken apart by a worker, then tracked one after the other like frames posted singly."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import AsyncIterator, Sequence
from dataclasses import replace
from datetime import datetime, timedelta

from service.errors import InputError
from service.imaging.split import PNG, SplitFrame
from service.sessions import config as session_config
from service.sessions.frame import Answer, FrameIn
from service.sessions.registry import Registry
from service.store.scope import SessionKey, tenant_of
from service.workers.engine import Engine
from service.workers.inspector import Inspector
from service.workers.splitting import SplitJob


class Batches:
    """Takes bodies of several frames."""

    def __init__(self, registry: Registry, engine: Engine, inspector: Inspector) -> None:
        self._registry = registry
        self._engine = engine
        self._inspector = inspector

    async def is_batch(self, session_id: SessionKey, body: bytes, media_type: str) -> bool:
        """Whether a body holds several frames (a video always counts as such). Raises ``ImageError``."""
        return await self._inspector.count(tenant_of(session_id), body, media_type) != 1

    async def track(self, session_id: SessionKey, whole: FrameIn) -> AsyncIterator[Answer]:
        """One answer per frame. Raises what a frame posted singly would; the frames before it stay tracked."""
        owner = await self._registry.get(session_id)
        config = session_config.stored(owner.record.config)
        job = SplitJob(whole.body, whole.media_type, config.camera.ser_byte_order)
        parts: Sequence[SplitFrame] = await self._engine.transport.call(session_id, "split", job)
        believed = config.camera.headers == "use"
        stamps = [part.facts.time if believed else None for part in parts]
        try:
            times = frame_times(whole.time, stamps, config.motion.frame_interval_s)
        except OverflowError as error:  # past the year 9999
            raise InputError("the frames' times leave the calendar", field="time") from error
        for k, part in enumerate(parts):
            frame = await asyncio.to_thread(_single, whole, k, part, times[k])
            owner = await self._registry.get(session_id)  # it may have been evicted since
            yield await owner.submit(frame)


def frame_times(
    first: datetime | None, stamps: Sequence[datetime | None], interval_s: float
) -> tuple[datetime | None, ...]:
    """Time of every frame: its own stamp, or the interval after the one before it, where any time is known.

    ``first``, given with the call, moves all stamps so that the first frame has it.
    """
    start = first or (stamps[0] if stamps else None)
    times: list[datetime | None] = []
    for k, stamp in enumerate(stamps):
        if stamp is not None and stamps[0] is not None and start is not None:
            times.append(start + (stamp - stamps[0]))
        elif k > 0 and (before := times[-1]) is not None:
            times.append(before + timedelta(seconds=interval_s))
        else:
            times.append(start if k == 0 else stamp)
    return tuple(times)


def _single(whole: FrameIn, k: int, part: SplitFrame, time: datetime | None) -> FrameIn:
    return replace(
        whole,
        body=part.body,
        sha256=hashlib.sha256(part.body).hexdigest(),
        media_type=PNG,
        index=None if whole.index is None else whole.index + k,
        idempotency_key=None if whole.idempotency_key is None else f"{whole.idempotency_key}#{k}",
        time=time,
        facts=part.facts,
    )
