"""Estimates with all that came after taken into account: the store's modes through the worker's smoother."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import orjson

from service.attitude.pointing import CameraOrientation
from service.inference.params import SessionConfig
from service.inference.pose import rotation_matrices
from service.inference.smoothed import SmoothedEstimate
from service.inference.state import Array
from service.sessions import config as session_config
from service.sessions.absolute import View, absolute_camera, camera_quaternion, rate_since
from service.sessions.contenders import model_of
from service.sessions.document import JointNames, smoothed_document
from service.sessions.library import articulation_of, twins_of
from service.store import frames, models, sessions
from service.store.base import ModelRecord, SessionRecord, StoredBelief
from service.store.database import Database
from service.store.scope import SessionKey, model_key
from service.workers.base import SmoothJob
from service.workers.engine import Engine

AHEAD = 1000  # frames smoothed at once for the pages that follow: some megabytes, and two thirds more time at most
KEPT = 8


@dataclass(frozen=True)
class _Stretch:
    """Smoothed frames from one on; ``times`` begins with that of the frame before."""

    first: int
    times: Sequence[float | None]
    names: JointNames
    estimates: Sequence[SmoothedEstimate | None]


class SmoothedPages:
    """Pages of smoothed estimates. Each goes back over the rest of the pass; the next ones come out of that."""

    def __init__(self, database: Database, engine: Engine) -> None:
        self._database = database
        self._engine = engine
        self._kept: OrderedDict[tuple[str, int, int], _Stretch] = OrderedDict()

    async def page(self, session_id: SessionKey, after: int, limit: int) -> tuple[list[bytes], int | None]:
        """Smoothed estimates after an index, and the index to go on from or None. Raises ``NotFoundError``.

        Pages of one stand of the session fit together. Where models are compared, the frames are smoothed in which the
        model led that now does; the others stay as they were.
        """
        record = await self._database.read(sessions.get, session_id)
        found = await self._database.read(frames.estimate_page, session_id, after, limit + 1)
        following = found[limit - 1][0] if len(found) > limit else None
        documents = [document for _, document in found[:limit]]
        if not documents:
            return [], None
        stretch = await self._stretch(record, after + 1, len(documents))
        earlier = None
        if after >= 0:
            earlier = await self._database.read(frames.estimate, session_id, after)
        return await asyncio.to_thread(_documents, earlier, documents, after + 1, stretch), following

    async def _stretch(self, record: SessionRecord, first: int, count: int) -> _Stretch:
        key = (record.id, record.number, record.next_index)  # what was smoothed is so until the next frame
        kept = self._kept.get(key)
        if kept is None or not kept.first <= first <= first + count <= kept.first + len(kept.estimates):
            kept = self._kept[key] = await self._smooth(record, first - 1, count)
        self._kept.move_to_end(key)
        if len(self._kept) > KEPT:
            self._kept.popitem(last=False)
        return kept

    async def _smooth(self, record: SessionRecord, after: int, count: int) -> _Stretch:
        model, others = await _leader(self._database, record, after)
        stored = await self._database.read(frames.belief_page, record.id, after)
        config = session_config.stored(record.config)
        before = next((row.time_s for row in stored if row.index == after), None)
        rows = [replace(row, belief=None) if row.index in others else row for row in stored if row.index > after]
        report = await self._engine.smooth(record.tenant, _job(config, record, model, rows, max(count, AHEAD)))
        times = [before, *(row.time_s for row in rows[: len(report.estimates)])]
        return _Stretch(after + 1, times, JointNames.of(articulation_of(model), config), report.estimates)


async def _leader(database: Database, record: SessionRecord, after: int) -> tuple[ModelRecord, frozenset[int]]:
    """The model that the estimates after an index are of, and those of them (indexes) that another one led."""
    if not record.model_ids:
        return await database.read(models.get, record.model_id), frozenset()
    documents = await database.read(frames.estimate_page, record.id, after, record.next_index)
    by_index = await asyncio.to_thread(lambda: {k: model_of(orjson.loads(document)) for k, document in documents})
    leads = by_index[max(by_index)]
    assert leads is not None, "a session that compares models ranks them in every estimate"
    model = await database.read(models.get, model_key(record.tenant, leads))
    return model, frozenset(k for k, name in by_index.items() if name != leads)


def _job(
    config: SessionConfig, record: SessionRecord, model: ModelRecord, rows: Sequence[StoredBelief], count: int
) -> SmoothJob:
    info = record.background_info or {}
    return SmoothJob(
        config=config,
        articulation=articulation_of(model),
        twins=twins_of(model),
        width=int(info["width"]),
        height=int(info["height"]),
        beliefs=tuple(row.belief for row in rows),
        count=count,
        radius=0.5 * float(np.linalg.norm(model.report["size"])),  # of its box: no smaller
    )


def _documents(earlier: bytes | None, documents: Sequence[bytes], first: int, stretch: _Stretch) -> list[bytes]:
    """The stored ``documents``, of frame ``first`` and on, with what was smoothed."""
    camera = None if earlier is None else camera_quaternion(orjson.loads(earlier))
    answers = []
    for k, document in enumerate(documents, first - stretch.first):
        filtered = orjson.loads(document)
        before, now = stretch.times[k], stretch.times[k + 1]
        dt_s = 0.0 if before is None or now is None else now - before
        answers.append(smoothed_document(filtered, stretch.names, stretch.estimates[k], _view(filtered, camera, dt_s)))
        camera = camera_quaternion(filtered)
    return answers


def _view(filtered: Mapping[str, Any], camera_before: Array | None, dt_s: float) -> View | None:
    """The camera as the stored estimate used it: turned towards where in the image the object was."""
    camera, towards = camera_quaternion(filtered), absolute_camera(filtered)
    if camera is None or towards is None:
        return None
    rate = None if camera_before is None else rate_since(camera_before, camera, dt_s)
    orientation = CameraOrientation(rotation_matrices(towards), filtered["camera"]["mirrored"], None, None)
    return View(orientation, (0.0, 0.0), rate)
