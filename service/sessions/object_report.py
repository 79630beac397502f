"""The report of an object: what its passes tell, in one file."""

from __future__ import annotations

import asyncio
from datetime import UTC, datetime
from typing import Any

from service.errors import ConflictError
from service.report.spin import ObjectFacts, object_html
from service.sessions.frame import format_time
from service.sessions.objects import Objects
from service.store.scope import ObjectKey


async def object_report(objects: Objects, object_id: ObjectKey, release: str) -> bytes:
    """HTML. Raises ``NotFoundError``, and ``ConflictError`` before the first frame."""
    tracked = await objects.get(object_id)
    passes = (await objects.pass_list(object_id))["passes"]
    if not passes:
        raise ConflictError("no session of this object has a frame yet", frames=0)
    spin, motion = None, None
    why_no_spin = why_no_motion = ""
    try:
        spin = await objects.spin(object_id)
        left_out: list[dict[str, Any]] = spin["left_out"]
    except ConflictError as error:
        why_no_spin, left_out = error.detail, error.facts.get("left_out", [])
    try:
        motion = await objects.motion(object_id, None)
    except ConflictError as error:
        why_no_motion = error.detail
    facts = ObjectFacts(
        tracked=tracked,
        passes=passes,
        spin=spin,
        why_no_spin=why_no_spin,
        left_out=left_out,
        motion=motion,
        why_no_motion=why_no_motion,
        version=release,
        made_at=format_time(datetime.now(UTC)),
    )
    return await asyncio.to_thread(object_html, facts)
