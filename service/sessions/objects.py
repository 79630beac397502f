"""Objects: what several sessions are of, and how it turned as all telescopes of a pass saw it (docs/objects.md)."""

from __future__ import annotations

import uuid
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime, timedelta
from typing import Any

import orjson

from service.errors import ConflictError, NotFoundError
from service.inference.spin.passes import LEAST_PASSES
from service.sessions.frame import format_time
from service.sessions.motion_document import DECIDED
from service.sessions.pass_motion import PassMotions
from service.sessions.spin_document import spin_document
from service.store import frames, objects
from service.store.base import ObjectRecord, Page
from service.store.database import Database
from service.store.scope import ObjectKey, SessionKey, object_key, public_id

PASS_GAP = timedelta(minutes=30)
"""Between two passes, at least: a low orbit takes an hour and a half, and is in sight of a region for a quarter."""
MOST_TELESCOPES = 16  # of a pass that are told in one: each brings all of its frames
Span = tuple[datetime, datetime]  # of a session's frames


class Objects:
    """Stored objects. Everything raises ``NotFoundError`` for what is not there."""

    def __init__(self, database: Database, motions: PassMotions, quota: int = 0) -> None:
        """``quota``: of a tenant; 0: any number."""
        self._database, self._motions, self._quota = database, motions, quota

    async def create(self, tenant: str, name: str, sessions: Iterable[SessionKey]) -> dict[str, Any]:
        """A new object that these sessions are of. Raises ``QuotaExceededError``."""
        key = object_key(tenant, str(uuid.uuid4()))
        record = ObjectRecord(key, name, format_time(datetime.now(UTC)), tenant=tenant, sessions=tuple(sessions))
        return object_document(await self._database.write(objects.add, record, self._quota))

    async def get(self, object_id: ObjectKey) -> dict[str, Any]:
        """One object."""
        return object_document(await self._database.read(objects.get, object_id))

    async def page(self, tenant: str, after: int, limit: int) -> Page[bytes]:
        """A tenant's objects after a cursor as JSON."""
        found = await self._database.read(objects.page, tenant, after, limit)
        return Page(tuple(orjson.dumps(object_document(one)) for one in found.records), found.damaged, found.cursor)

    async def join(self, object_id: ObjectKey, session_id: SessionKey) -> dict[str, Any]:
        """A session is of this object."""
        return object_document(await self._database.write(objects.join, object_id, session_id))

    async def leave(self, object_id: ObjectKey, session_id: SessionKey) -> None:
        """It is of it no more."""
        await self._database.write(objects.leave, object_id, session_id)

    async def remove(self, object_id: ObjectKey) -> None:
        """The object is forgotten; its sessions stay."""
        await self._database.write(objects.remove, object_id)

    async def passes(self, object_id: ObjectKey) -> list[list[tuple[SessionKey, Span]]]:
        """The object's passes in order of time, each with the sessions that saw it and when."""
        record = await self._database.read(objects.get, object_id)
        spans = [(one, await self._database.read(frames.span, one)) for one in record.sessions]
        return passes_of([(one, _span(times)) for one, times in spans if times is not None])

    async def pass_list(self, object_id: ObjectKey) -> dict[str, Any]:
        """The object's passes: when, and which sessions saw it."""
        passes = [
            {
                "pass": number,
                "start": format_time(min(first for _, (first, _) in seen)),
                "end": format_time(max(last for _, (_, last) in seen)),
                "sessions": [public_id(one) for one, _ in seen],
            }
            for number, seen in enumerate(await self.passes(object_id))
        ]
        return {"object_id": public_id(object_id), "passes": passes}

    async def motion(self, object_id: ObjectKey, number: int | None) -> dict[str, Any]:
        """How it turned in a pass (None: the last), by all telescopes that saw it. Raises ``ConflictError``."""
        passes = await self.passes(object_id)
        if not passes:
            raise ConflictError("no session of this object has a frame yet", frames=0)
        at = len(passes) - 1 if number is None else number
        if at >= len(passes):
            raise NotFoundError(f"the object has {len(passes)} passes, numbered from 0", field="query:pass")
        sessions = [one for one, _ in passes[at]]
        if len(sessions) > MOST_TELESCOPES:
            raise ConflictError("more telescopes than are told in one", sessions=len(sessions), limit=MOST_TELESCOPES)
        found: dict[str, Any] = orjson.loads(await self._motions.of(*sessions))
        place = {"object_id": public_id(object_id), "pass": at, "passes": len(passes)}
        return {**place, "sessions": [public_id(one) for one in sessions], **found}

    async def spin(self, object_id: ObjectKey) -> dict[str, Any]:
        """Rate, axis and their trend over all passes in which a turning is seen. Raises ``ConflictError``."""
        count = len(await self.passes(object_id))
        found, left_out = [], []
        for number in range(count):
            try:
                one = await self.motion(object_id, number)
            except ConflictError as error:
                left_out.append({"pass": number, "reason": error.detail})
                continue
            reason = _not_counted(one)
            if reason is not None:
                left_out.append({"pass": number, "reason": reason})
                continue
            found.append(one)
        if len(found) < LEAST_PASSES:
            detail = f"a spin over passes needs {LEAST_PASSES} of them in which a turning is seen against the stars"
            raise ConflictError(detail, passes=count, left_out=left_out)
        return spin_document(public_id(object_id), found, left_out)


def passes_of(spans: Iterable[tuple[SessionKey, Span]]) -> list[list[tuple[SessionKey, Span]]]:
    """Sessions by pass, both in order of time: between two passes nobody sees the object for ``PASS_GAP``."""
    found: list[list[tuple[SessionKey, Span]]] = []
    last: datetime | None = None
    for session, (first, end) in sorted(spans, key=lambda one: one[1]):
        if last is None or first - last >= PASS_GAP:
            found.append([])
        found[-1].append((session, (first, end)))
        last = end if last is None else max(last, end)
    return found


def _not_counted(motion: Mapping[str, Any]) -> str | None:
    """Why a pass tells nothing of the spin over passes; None: it does."""
    if motion["relative_to"] != "GCRF":
        return "the camera's orientation is not known"
    if motion["period_s"] is None:
        return "no turning is seen"
    return "its motion is not decided" if motion["probability"] < DECIDED else None


def object_document(record: ObjectRecord) -> dict[str, Any]:
    """An object as the API answers it."""
    return {
        "object_id": public_id(record.id),
        "name": record.name,
        "created_at": record.created_at,
        "sessions": [public_id(one) for one in record.sessions],
    }


def _span(times: tuple[str, str]) -> Span:
    first, last = (datetime.fromisoformat(one) for one in times)
    return first, last
