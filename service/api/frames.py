"""Routes that bring images: background and frames."""

from __future__ import annotations

import asyncio
import uuid
from datetime import UTC, datetime
from typing import Annotated, Any
from urllib.parse import quote

import orjson
from fastapi import APIRouter, Path, Query, Request, Response
from pydantic import AwareDatetime, BaseModel, ConfigDict, Field

from service.access.principal import Principal, SessionKey, public_id
from service.api import schemas
from service.api.auth import OperateSession, Operator, Reader, ReadSession
from service.api.batches import stream_batch
from service.api.bodies import idempotency_key, media_type, read_body, wants_async
from service.api.description import bytes_sent
from service.api.forwarding import Call
from service.api.paging import problems
from service.api.services import Services, ServicesDep
from service.errors import InputError
from service.sessions.frame import Answer, BackgroundIn, FrameIn, kind_of
from service.sessions.lighting import told_sun
from service.sessions.session import Session

router = APIRouter(prefix="/v1/sessions/{session_id}", tags=["frames"])
_IMAGE = bytes_sent(
    "A file of one or several images. Its own `Content-Type` may be sent: `image/png`, `image/tiff`, `image/jpeg`, "
    "`image/fits`, `application/fits`, `application/x-npy`, `application/imagebytes`, `video/x-ser`, "
    "`application/x-ser`, `video/*`. As `application/octet-stream` it is what its first bytes say."
)
_HEADERS = [
    {"name": "Idempotency-Key", "in": "header", "schema": {"type": "string", "maxLength": 255}},
    {"name": "Prefer", "in": "header", "schema": {"type": "string", "examples": ["respond-async"]}},
]
_REFUSALS = problems(404, 409, 413, 415, 422, 429, 503)
_ACCEPTED: dict[int | str, dict[str, Any]] = {
    202: {"model": schemas.Submission, "description": "Taken (Prefer: respond-async); not yet tracked"}
}


class FrameQuery(BaseModel):
    """What a client knows about a frame."""

    model_config = ConfigDict(extra="forbid", use_attribute_docstrings=True, allow_inf_nan=False)

    time: AwareDatetime | None = None
    """Middle of the exposure, ISO 8601 with `Z` or an offset. Without it the frame is taken to follow the one
    before after the session's `motion.frame_interval_s`."""
    ra_deg: Annotated[float, Field(ge=-360, le=360)] | None = None
    """Right ascension of the optical axis."""
    dec_deg: Annotated[float, Field(ge=-90, le=90)] | None = None
    """Declination of the optical axis."""
    position_angle_deg: Annotated[float, Field(ge=-360, le=360)] | None = None
    """Position angle of the image's up direction, from north through east."""
    az_deg: Annotated[float, Field(ge=-360, le=360)] | None = None
    """Azimuth of the optical axis from north through east. With `el_deg` it goes before `ra_deg` and `dec_deg`, and
    needs `time` and the session's `camera.site_latitude_deg` and `camera.site_longitude_deg`."""
    el_deg: Annotated[float, Field(ge=-90, le=90)] | None = None
    """Elevation of the optical axis, without refraction."""
    sun: Annotated[str, Field(max_length=200)] | None = None
    """`x,y,z` towards the Sun in camera axes: x right, y down, z away from the camera; any length. It goes before the
    session's `light.sun`."""


FrameQueryDep = Annotated[FrameQuery, Query()]


class BackgroundQuery(BaseModel):
    """Where no empty frame exists: which part of the image shows only background."""

    model_config = ConfigDict(extra="forbid", use_attribute_docstrings=True)

    box: str | None = None
    """`x,y,w,h` in pixels: learn outside of this box, in which the object is. Where that is no sky but clutter, the
    object is followed by its outline and texture."""
    border: Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)] | None = None
    """Pixels: learn from the border of this width only."""


@router.post(
    "/background",
    response_model=schemas.BackgroundResult,
    responses=_REFUSALS,
    openapi_extra={**_IMAGE, "parameters": _HEADERS[:1]},
)
async def add_background(
    session: OperateSession,
    caller: Operator,
    request: Request,
    services: ServicesDep,
    query: Annotated[BackgroundQuery, Query()],
) -> Response:
    """Teach the session what empty sky looks like: one image, or a multi-frame file."""
    services.limits.check(caller, "pixels")
    await services.registry.require_room(session)
    forwarding = services.forwarding
    box = None if query.box is None else _box(query.box)
    if box is not None and query.border is not None:
        raise InputError("give box or border, not both", field="query:border")
    body, sha256 = await read_body(request)
    image = BackgroundIn(
        body=body,
        sha256=sha256,
        media_type=kind_of(media_type(request), body),
        idempotency_key=idempotency_key(request) or forwarding.key_for_retries(),
        box=box,
        border_px=query.border,
    )

    async def here(owner: Session) -> Response:
        answer = await owner.submit_background(image)
        services.limits.take(caller, "pixels", owner.frame_pixels)
        return _json(orjson.dumps({"background_frames": answer.background_frames, "state": answer.state}))

    return await forwarding.at_owner(Call.of(request, session, caller, body, image.idempotency_key), here)


@router.post(
    "/frames",
    response_model=schemas.Estimate,
    responses={**_ACCEPTED, **_REFUSALS},
    openapi_extra={**_IMAGE, "parameters": _HEADERS},
)
async def post_frame(
    session: OperateSession, caller: Operator, request: Request, services: ServicesDep, query: FrameQueryDep
) -> Response:
    """Track the next frame. The answer comes after it is stored."""
    return await _take(session, None, caller, request, services, query)


@router.put(
    "/frames/{index}",
    response_model=schemas.Estimate,
    responses={**_ACCEPTED, **_REFUSALS},
    openapi_extra={**_IMAGE, "parameters": _HEADERS},
)
async def put_frame(
    session: OperateSession,
    caller: Operator,
    index: Annotated[int, Path(ge=0, le=2**53)],
    request: Request,
    services: ServicesDep,
    query: FrameQueryDep,
) -> Response:
    """Track frame `index`, exactly once: the same bytes again give the same answer, other bytes a conflict."""
    return await _take(session, index, caller, request, services, query)


@router.get(
    "/frames/by-key/{key:path}",
    response_model=schemas.Estimate,
    responses={202: {"model": schemas.Submission, "description": "Under way"}, **problems(404)},
)
async def read_submission(
    session: ReadSession, caller: Reader, key: str, request: Request, services: ServicesDep
) -> Response:
    """What became of a frame posted with this Idempotency-Key, or with `Prefer: respond-async`."""
    document = await services.archive.by_key(session, key)
    if document is not None:
        return _json(document)
    if not services.submissions.pending(session, key):
        document = await services.archive.by_key(session, key)  # it may have been stored since
        if document is not None:
            return _json(document)
        elsewhere = await services.forwarding.at_peer(Call.of(request, session, caller))
        if elsewhere is not None:
            return elsewhere
        await services.archive.require_key(session, key)
    return _accepted(session, key)


async def _take(
    session: SessionKey, index: int | None, caller: Principal, request: Request, services: Services, query: FrameQuery
) -> Response:
    received = datetime.now(UTC)
    services.limits.check(caller, "pixels")
    if query.sun is not None:
        told_sun(query.sun)
    await services.registry.require_room(session)
    body, sha256 = await read_body(request)
    in_background = wants_async(request)
    key = idempotency_key(request) or (str(uuid.uuid4()) if in_background else None)
    if index is None:
        key = key or services.forwarding.key_for_retries()
    frame = FrameIn(
        body=body,
        sha256=sha256,
        media_type=kind_of(media_type(request), body),
        received=received,
        index=index,
        idempotency_key=key,
        time=query.time,
        query=query.model_dump(mode="json", exclude_none=True),
    )
    is_batch = await services.batches.is_batch(session, body, frame.media_type)

    async def here(owner: Session) -> Response:
        if is_batch:
            return await stream_batch(services, session, caller, frame, in_background)
        answer = owner.submit(frame)
        services.limits.take(caller, "pixels", owner.frame_pixels)
        if in_background and key is not None:
            services.submissions.follow(session, key, _held(services, caller.tenant, len(body), answer))
            return _accepted(session, key)
        result = await answer
        location = f"/v1/sessions/{public_id(session)}/estimates/{result.index}"
        return _json(result.document, {"Content-Location": location})

    return await services.forwarding.at_owner(Call.of(request, session, caller, body, key), here)


async def _held(services: Services, tenant: str, size: int, answer: asyncio.Future[Answer]) -> None:
    """Count the body's bytes until the frame is answered: the request that brought it ends before."""
    services.admission.add(tenant, size)
    try:
        await answer
    finally:
        services.admission.add(tenant, -size)


def _accepted(session: SessionKey, key: str) -> Response:
    session_id = public_id(session)
    location = f"/v1/sessions/{session_id}/frames/by-key/{quote(key, safe='')}"
    body = {"session_id": session_id, "key": key, "state": "pending", "location": location}
    headers = {"Location": location, "Retry-After": "1", "Preference-Applied": "respond-async"}
    return Response(orjson.dumps(body), 202, headers, "application/json")


def _json(document: bytes, headers: dict[str, str] | None = None) -> Response:
    return Response(document, media_type="application/json", headers=headers)


def _box(text: str) -> tuple[float, float, float, float]:
    try:
        x, y, w, h = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError("box is x,y,w,h in pixels", field="query:box") from error
    if not (abs(x) <= 1e6 and abs(y) <= 1e6 and 0 < w <= 1e6 and 0 < h <= 1e6):
        raise InputError("box needs a positive width and height, below 1e6", field="query:box", limit=1e6)
    return x, y, w, h
