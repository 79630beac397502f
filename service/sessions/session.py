"""One tracked object: the only owner of its state. Takes frames in order, one at a time."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import time
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial

import orjson
import structlog

from service.errors import NoBackgroundError, SkyposeError, StaleOwnerError
from service.imaging.facts import NOTHING, FrameFacts
from service.inference.params import SessionConfig
from service.metrics import Metrics
from service.sessions.ahead import prepare
from service.sessions.consistency import warnings_of
from service.sessions.contenders import Contender, leader, ranking, stored
from service.sessions.document import as_duplicate, estimate_document
from service.sessions.frame import (
    Answer,
    BackgroundAnswer,
    BackgroundIn,
    FrameIn,
    FrameTime,
    assumed_of,
    format_time,
    frame_time,
    is_own_sky,
    known_background,
    learns_own_sky,
    repeated,
    require_going_on,
)
from service.sessions.hub import Hub
from service.sessions.inbox import Inbox
from service.sessions.known import Known
from service.sessions.lighting import light_at
from service.sessions.line import Line
from service.sessions.pointings import Pointings
from service.sessions.ranging import Ranging, scale_bounds
from service.store import frames, models, sessions
from service.store.base import BackgroundRecord, FrameRecord, Retention, SessionRecord
from service.store.database import Database
from service.store.scope import public_id, tenant_of
from service.workers.base import BackgroundJob, FrameJob, PackedFrameReport
from service.workers.engine import Engine
from service.workers.inspector import Inspector

log = structlog.get_logger(__name__)
Contenders = tuple[Contender, ...]


@dataclass(frozen=True)
class Rooms:
    """What a session works with."""

    engine: Engine
    inspector: Inspector
    database: Database
    hub: Hub
    metrics: Metrics
    retention: Retention
    line: Line


class Session:
    """The owner. Lives in memory while the session is in use; everything it knows is in the store."""

    def __init__(
        self,
        rooms: Rooms,
        record: SessionRecord,
        config: SessionConfig,
        contenders: Contenders,
    ) -> None:
        self.record = record
        self.inbox = Inbox(record.id, rooms.line, rooms.metrics.stage_seconds.labels("wait").observe)
        self._rooms = rooms
        self._config = config
        self._contenders = contenders
        self._pointings = Pointings(config.camera)
        self._ranging = Ranging(config)
        self._taken: datetime | None = None  # the frame before

    @property
    def frame_pixels(self) -> int:
        """Pixels of a frame: those of the background; 0 before there is one."""
        width, height = self._frame_size or (0, 0)
        return width * height

    @property
    def _frame_size(self) -> tuple[int, int] | None:
        info = self.record.background_info
        return None if info is None else (int(info["width"]), int(info["height"]))

    def submit(self, frame: FrameIn) -> asyncio.Future[Answer]:
        """Queue a frame. The future holds the answer once it is committed."""
        return self.inbox.put(partial(self._frame, frame))

    def submit_background(self, image: BackgroundIn) -> asyncio.Future[BackgroundAnswer]:
        """Queue a background image."""
        return self.inbox.put(partial(self._background, image))

    async def _frame(self, frame: FrameIn) -> Answer:
        record = self.record
        at_index, under_key = await self._rooms.database.read(
            frames.find, record.id, index=frame.index, key=frame.idempotency_key, epoch=record.epoch
        )
        index = repeated(frame, record.next_index, at_index, under_key)
        if index is not None:
            document = await self._rooms.database.read(frames.estimate, record.id, index)
            self._rooms.metrics.duplicates.inc()
            return Answer(index, as_duplicate(document), duplicate=True)
        require_going_on(record)
        if learns_own_sky(self._config, record):
            await self._learn(BackgroundIn(frame.body, frame.sha256, frame.media_type), own=True)
        if self.record.background_key is None:
            raise NoBackgroundError("post a background image first", field="background")
        await self._resume()
        facts = await self._facts(frame)
        frame = replace(frame, time=frame.time or facts.time)
        moment = frame_time(record, frame, self._config.motion.frame_interval_s, self._taken)
        known = await asyncio.to_thread(self._known, frame, facts, moment)
        contenders, report = await self._track(frame, self.record.background_key, known)
        return await self._commit(frame, known, contenders, report)

    async def _facts(self, frame: FrameIn) -> FrameFacts:
        """What the frame's own header says, where the session believes it."""
        if self._config.camera.headers == "ignore":
            return NOTHING
        if frame.facts is not None:
            return frame.facts
        return await self._rooms.inspector.facts(tenant_of(self.record.id), frame.body, frame.media_type)

    async def _resume(self) -> None:
        """What is remembered of the frame before; a session that was restored reads it from the store."""
        if self.record.next_index > 0 and not self._pointings.started:
            document = await self._rooms.database.read(frames.estimate, self.record.id, self.record.next_index - 1)
            estimate = await asyncio.to_thread(orjson.loads, document)
            self._pointings.resume(estimate)
            self._taken = datetime.fromisoformat(estimate["time"])

    def _known(self, frame: FrameIn, facts: FrameFacts, moment: FrameTime) -> Known:
        """The camera at this frame and how it turned since the frame before, the object's range, the light."""
        view = self._pointings.view(self.record, frame, facts, moment)
        aim = self._pointings.aim(self.record, frame, facts, moment)
        ranged = self._ranging.at(moment, facts)
        lit = light_at(self._config, frame.query, moment, view, ranged)
        return Known(moment, view, aim, ranged, lit, self._ranging.held(moment, view))

    async def _track(self, frame: FrameIn, background: str, known: Known) -> tuple[Contenders, PackedFrameReport]:
        """The frame under every model, one job after the other; the report of the most probable."""
        after, reports = [], []
        for contender in self._contenders:
            report = await self._track_one(contender, frame, background, known)
            after.append(contender.after(report))
            reports.append(report)
        return tuple(after), reports[leader(after)]

    async def _track_one(
        self, contender: Contender, frame: FrameIn, background: str, known: Known
    ) -> PackedFrameReport:
        job = FrameJob(
            config=self._config,
            model=contender.model.blob_key,
            file_type=contender.model.file_type,
            articulation=contender.articulation,
            background=background,
            state=None,
            frame_index=self.record.next_index,
            time_s=known.moment.seconds,
            body=frame.body,
            media_type=frame.media_type,
            twins=contender.twins,
            size=self._frame_size,
            scale_px=scale_bounds(self._config.prior, known.ranged),
            light=known.lit.light,
            held=known.held,
        )
        return await self._rooms.engine.track(self.record.id, job, contender.state, self._blob)

    async def _commit(self, frame: FrameIn, known: Known, contenders: Contenders, report: PackedFrameReport) -> Answer:
        moment, index, text = known.moment, self.record.next_index, format_time(known.moment.utc)
        document = await asyncio.to_thread(self._document, frame, known, contenders, report)
        given = None if moment.given is None else moment.given.isoformat()
        record = FrameRecord(
            session_id=self.record.id,
            epoch=self.record.epoch,
            index=index,
            sha256=frame.sha256,
            idempotency_key=frame.idempotency_key,
            media_type=frame.media_type,
            time=text,
            time_given=given,
            time_s=moment.seconds,
            query=frame.query,
            body=frame.body,
            status=report.estimate.status,
            document=document,
            state=report.state,
            created_at=format_time(frame.received),
            belief=report.belief,
            contenders=stored(contenders),
        )
        started = time.monotonic()
        seq = await self._store(record)
        timing, told = {**report.timing_ms, "commit": 1e3 * (time.monotonic() - started)}, report.estimate
        self._rooms.metrics.tracked(told.status, told.ess / max(told.n_particles, 1), timing)
        self._contenders = contenders
        self._pointings.passed(known.view)
        self._taken = moment.utc
        self.record = replace(
            self.record,
            next_index=index + 1,
            next_seq=seq + 1,
            status=record.status,
            time_s=record.time_s,
            time_given=given,
            updated_at=record.created_at,
        )
        self._rooms.hub.publish(self.record.id, seq, document)
        log.info("frame", frame=index, status=record.status, ms=round(report.timing_ms.get("total", 0), 1))
        return Answer(index, document, duplicate=False)

    def _document(self, frame: FrameIn, known: Known, contenders: Contenders, report: PackedFrameReport) -> bytes:
        """The estimate as it is stored and answered."""
        view, ranged, utc = known.view, known.ranged, known.moment.utc
        names = contenders[leader(contenders)].names
        models = ranking(contenders) if len(contenders) > 1 else None
        orbit = None if ranged is None else ranged.document()
        session_id, index, text = public_id(self.record.id), self.record.next_index, format_time(utc)
        odd = warnings_of(report.estimate, utc, self._ranging.site, known.aim, ranged)
        assumed = assumed_of(self.record, frame, held=known.held is not None)
        return estimate_document(session_id, index, text, names, report, view, models, orbit, known.lit, assumed, odd)

    async def _store(self, record: FrameRecord) -> int:
        try:
            return await self._rooms.database.write(frames.append, record, self._rooms.retention)
        except StaleOwnerError:
            self._rooms.metrics.fenced.inc()
            log.warning("session taken by another; nothing of the frame is stored", frame=record.index)
            raise

    async def _background(self, image: BackgroundIn) -> BackgroundAnswer:
        if image.idempotency_key is not None:
            known = await self._rooms.database.read(sessions.find_background, self.record.id, image.idempotency_key)
            if known is not None:
                return known_background(image, *known)
        require_going_on(self.record)
        return await self._learn(image, own=False)

    async def _learn(self, image: BackgroundIn, own: bool) -> BackgroundAnswer:
        """``own``: the image shows the object."""
        record, database = self.record, self._rooms.database
        mine = record.background_key if own or not is_own_sky(record) else None  # what is posted begins anew
        learned = None if mine is None else await self._blob(mine)
        look = image.box, image.border_px, own
        job = BackgroundJob(self._config, image.body, image.media_type, learned, *look, size=self._frame_size)
        report = await self._rooms.engine.learn_background(record.id, job)
        info = {name: getattr(report, name) for name in ("height", "width", "channels", "bits")}
        info |= {"source": "auto"} if own else {}
        background = BackgroundRecord(
            session_id=record.id,
            epoch=record.epoch,
            sha256=image.sha256,
            idempotency_key=image.idempotency_key,
            key=(await asyncio.to_thread(hashlib.sha256, report.background)).hexdigest(),
            data=report.background,
            frames=report.frames,
            info=info,
            created_at=format_time(datetime.now(UTC)),
        )
        await database.write(sessions.set_background, background)
        first = record.background_key is None
        self.record = replace(
            record, background_key=background.key, background_frames=report.frames, background_info=info
        )
        if first and not own:
            with contextlib.suppress(SkyposeError):  # no room, or at its end: the first frame prepares it then
                self.inbox.put(
                    partial(prepare, self._rooms.engine, record.id, self._config, self._contenders, self._blob)
                )
        return BackgroundAnswer(report.frames)

    async def _blob(self, key: str) -> bytes:
        return await self._rooms.database.read(models.get_blob, key)
