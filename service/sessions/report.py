"""The report of a session: what the store and the worker know of it, in one file."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
import orjson

from service.errors import BackendMissingError, ConflictError, GoneError
from service.report.film import Shot
from service.report.page import Facts, evenly, report_html
from service.sessions.archive import EVERYTHING, Archive
from service.sessions.frame import format_time
from service.sessions.library import Library
from service.sessions.status import Status
from service.store.scope import SessionKey, model_key, tenant_of
from service.workers.base import Shown

_MOST_SHOTS = 12  # frames that are drawn: each costs the side process some 100 ms
_SHOWN: tuple[Shown, ...] = ("overlay", "model", "residual")
_ROOM = 1.3  # side of a picture in diameters of the body
_LEAST_SPAN_PX = 32.0

Document = Mapping[str, Any]


class Reports:
    """Made when they are asked for. ``kept``: frame files that a session keeps, newest first."""

    def __init__(self, archive: Archive, library: Library, status: Status, kept: int) -> None:
        self._archive = archive
        self._library = library
        self._status = status
        self._kept = kept

    async def of(self, session_id: SessionKey, release: str) -> bytes:
        """HTML. Raises ``NotFoundError``, and ``ConflictError`` before the first frame."""
        session = await self._archive.session(session_id)
        if not session["frames"]:
            raise ConflictError("no frame was tracked yet", frames=0)
        stored, _ = await self._archive.smoothed(session_id, -1, EVERYTHING)
        estimates = await asyncio.to_thread(lambda: [orjson.loads(document) for document in stored])
        ids = session["model_ids"] or [session["model_id"]]
        tenant = tenant_of(session_id)
        models = [await self._library.get(model_key(tenant, name)) for name in ids]
        motion, why_no_motion = await self._motion(session_id)
        shots, why_no_pictures = await self._shots(session_id, estimates)
        facts = Facts(
            session=session,
            models=models,
            estimates=estimates,
            motion=motion,
            why_no_motion=why_no_motion,
            shots=shots,
            why_no_pictures=why_no_pictures,
            span_px=_span(models, estimates),
            system={"version": release, "worker": await self._status.worker()},
            made_at=format_time(datetime.now(UTC)),
        )
        return await asyncio.to_thread(report_html, facts)

    async def _motion(self, session_id: SessionKey) -> tuple[Document | None, str]:
        try:
            return orjson.loads(await self._archive.motion(session_id)), ""
        except ConflictError as error:
            return None, error.detail

    async def _shots(self, session_id: SessionKey, estimates: Sequence[Document]) -> tuple[list[Shot], str]:
        """Pictures of frames spread over those whose files are kept, and why some are missing."""
        first = max(len(estimates) - self._kept, 0)
        why = "" if first == 0 else f"Of the first {first} frames no file is kept."
        shown, shots = _SHOWN, list[Shot]()
        for k in evenly(len(estimates) - first, _MOST_SHOTS):
            index, best = first + k, estimates[first + k]["best"]
            if estimates[index]["status"] == "no_target":
                continue
            try:
                drawn = await self._archive.pictures(session_id, index, shown)
            except BackendMissingError as error:
                shown, why, shots = _SHOWN[:1], f"{error.detail[0].upper()}{error.detail[1:]}.", []
                drawn = await self._archive.pictures(session_id, index, shown)
            except GoneError as error:  # pruned meanwhile
                why = f"{error.detail[0].upper()}{error.detail[1:]}."
                continue
            shots.append(Shot(index, best["x_px"], best["y_px"], dict(zip(shown, drawn, strict=True))))
        return shots, why


def _span(models: Sequence[Document], estimates: Sequence[Document]) -> float:
    """Side in px of a square that holds the body in every frame."""
    diameter = max(float(np.linalg.norm(model["size"])) for model in models)
    scale = float(np.median([estimate["best"]["scale_px"] for estimate in estimates]))
    return max(_ROOM * diameter * scale, _LEAST_SPAN_PX)
