"""Estimates with all that came after taken into account: the store's modes through the worker's smoother."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import orjson

from service.attitude.pointing import CameraOrientation
from service.inference.params import SessionConfig
from service.inference.pose import conjugate, multiply, rotation_matrices
from service.inference.smoothed import SmoothedEstimate
from service.inference.state import Array
from service.sessions import config as session_config
from service.sessions.absolute import View, camera_quaternion, rate_since
from service.sessions.contenders import require_one_model
from service.sessions.document import JointNames, smoothed_document
from service.sessions.library import articulation_of, twins_of
from service.store import frames, models, sessions
from service.store.base import ModelRecord, SessionRecord, StoredBelief
from service.store.database import Database
from service.store.scope import SessionKey
from service.workers.base import SmoothJob
from service.workers.engine import Engine


async def smoothed_page(
    database: Database, engine: Engine, session_id: SessionKey, after: int, limit: int
) -> tuple[list[bytes], int | None]:
    """Smoothed estimates after an index, and the index to go on from or None. Raises ``NotFoundError``, or
    ``ConflictError`` for a session that compares models.

    Every page goes back over the whole rest of the pass, so that pages of one stand of the session fit together.
    """
    record = await database.read(sessions.get, session_id)
    require_one_model(record, "smoothed estimates")
    found = await database.read(frames.estimate_page, session_id, after, limit + 1)
    following = found[limit - 1][0] if len(found) > limit else None
    documents = [document for _, document in found[:limit]]
    if not documents:
        return [], None
    model = await database.read(models.get, record.model_id)
    stored = await database.read(frames.belief_page, session_id, after)
    config = session_config.parse(orjson.dumps(record.config))
    before = next((row.time_s for row in stored if row.index == after), None)
    rows = [row for row in stored if row.index > after]
    report = await engine.smooth(_job(config, record, model, rows, len(documents)))
    earlier = None if before is None else await database.read(frames.estimate, session_id, after)
    names = JointNames.of(articulation_of(model), config)
    times = [before, *(row.time_s for row in rows)]
    return await asyncio.to_thread(_documents, earlier, documents, times, names, report.estimates), following


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
    )


def _documents(
    earlier: bytes | None,
    documents: Sequence[bytes],
    times: Sequence[float | None],
    names: JointNames,
    smoothed: Sequence[SmoothedEstimate | None],
) -> list[bytes]:
    """``times``: of the frame before the first, then of each."""
    camera = None if earlier is None else camera_quaternion(orjson.loads(earlier))
    answers = []
    for k, (document, estimate) in enumerate(zip(documents, smoothed, strict=True)):
        filtered = orjson.loads(document)
        before, now = times[k], times[k + 1]
        dt_s = 0.0 if before is None or now is None else now - before
        answers.append(smoothed_document(filtered, names, estimate, _view(filtered, camera, dt_s)))
        camera = camera_quaternion(filtered)
    return answers


def _view(filtered: Mapping[str, Any], camera_before: Array | None, dt_s: float) -> View | None:
    """The camera as the stored estimate used it: turned towards where in the image the object was."""
    camera, attitude = camera_quaternion(filtered), filtered["best"]["attitude"]
    if camera is None or attitude is None:
        return None
    towards = multiply(_quaternion(attitude), conjugate(_quaternion(filtered["best"])))
    rate = None if camera_before is None else rate_since(camera_before, camera, dt_s)
    orientation = CameraOrientation(rotation_matrices(towards), filtered["camera"]["mirrored"], None, None)
    return View(orientation, (0.0, 0.0), rate)


def _quaternion(document: Mapping[str, Any]) -> Array:
    return np.array([document["orientation"][axis] for axis in "wxyz"])
