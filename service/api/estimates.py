"""Routes that read what was tracked: estimates, overlay, particles, export."""

from __future__ import annotations

import asyncio
import io
from typing import Annotated, Any, Literal

import numpy as np
import orjson
from fastapi import APIRouter, Path, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from service.api import schemas
from service.api.auth import ReadSession
from service.api.description import bytes_answered
from service.api.health import release
from service.api.motion import PassMotion
from service.api.paging import next_page, page_limit, page_response, problems
from service.api.report_file import report_file
from service.api.services import ServicesDep
from service.exports.formats import FORMATS
from service.sessions.particle_set import ParticleSet

router = APIRouter(prefix="/v1/sessions/{session_id}", tags=["estimates"])
NPZ = "application/x-npz"
Index = Annotated[int, Path(ge=0, le=2**53)]


class ExportQuery(BaseModel):
    """What to export, and how the object is called there."""

    model_config = ConfigDict(extra="forbid", use_attribute_docstrings=True)

    format: Literal["aem", "acm", "apm", "stk", "czml", "csv", "npz"] = "csv"
    """CCSDS AEM, ACM (with covariance) or APM 2.0 (KVN), STK attitude file, CZML, or a table of every estimate."""
    pose: Literal["best", "mean"] = "best"
    """Which of an estimate's poses."""
    object_name: Annotated[str, Field(max_length=200)] | None = None
    """By default the session's name, or else its id."""
    object_id: Annotated[str, Field(max_length=200)] = "UNKNOWN"
    """International designator, YYYY-NNNP."""
    smoothed: bool | None = None
    """With all later frames taken into account, as in the list of estimates. By default of a session that has ended."""
    model: bool = False
    """With `czml`: the mesh itself, its parts moved as the joints were. `prior.unit_m` says how large it is."""


class EstimatesQuery(BaseModel):
    """Which estimates."""

    model_config = ConfigDict(extra="forbid", use_attribute_docstrings=True)

    after: Annotated[int, Field(ge=-1, le=2**53)] = -1
    """Frames after this index"""
    limit: Annotated[int, Field(ge=1)] = 100
    smoothed: bool = False
    """With all later frames taken into account"""


class ParticlesQuery(BaseModel):
    """Which particles, and how many."""

    model_config = ConfigDict(extra="forbid", use_attribute_docstrings=True)

    index: Annotated[int, Field(ge=0, le=2**53)] | None = None
    """Frame; the newest by default"""
    most: Annotated[int, Field(ge=1)] | None = None
    """No more than so many, drawn by their weights"""


@router.get("/estimates", response_model=schemas.EstimateList, responses=problems(404, 422, 503))
async def list_estimates(
    session_id: str,
    session: ReadSession,
    services: ServicesDep,
    query: Annotated[EstimatesQuery, Query()],
) -> Response:
    """Estimates in order of their frames.

    With `smoothed=true` pose, spread, modes and rates are those given the whole pass so far (a backward smoother),
    and each estimate says in `smoothed` whether that was possible.
    """
    limit, more = page_limit(query.limit, services.settings), "&smoothed=true" if query.smoothed else ""
    read = services.archive.smoothed if query.smoothed else services.archive.estimates
    found, cursor = await read(session, query.after, limit)
    following = next_page(f"/v1/sessions/{session_id}/estimates", cursor, limit, more)
    return page_response("estimates", found, following)


@router.get("/estimates/latest", response_model=schemas.Estimate, responses=problems(404))
async def latest_estimate(session: ReadSession, services: ServicesDep) -> Response:
    """The newest estimate."""
    return _json(await services.archive.estimate(session, None))


@router.get("/estimates/{index}", response_model=schemas.Estimate, responses=problems(404, 422))
async def read_estimate(session: ReadSession, index: Index, services: ServicesDep) -> Response:
    """The estimate of one frame."""
    return _json(await services.archive.estimate(session, index))


@router.get(
    "/estimates/{index}/overlay.png",
    response_class=Response,
    responses={**bytes_answered("image/png"), **problems(404, 410, 422, 503)},
)
async def read_overlay(session: ReadSession, index: Index, services: ServicesDep) -> Response:
    """The frame with the best silhouette in blue (the paper's Table 1)."""
    return await _picture(session, index, services, "overlay")


@router.get(
    "/estimates/{index}/frame.png",
    response_class=Response,
    responses={**bytes_answered("image/png"), **problems(404, 410, 422, 503)},
)
async def read_picture(session: ReadSession, index: Index, services: ServicesDep) -> Response:
    """The frame alone, 8 bits, stretched where people would see nothing otherwise."""
    return await _picture(session, index, services, "frame")


@router.get(
    "/estimates/{index}/model.png",
    response_class=Response,
    responses={**bytes_answered("image/png"), **problems(404, 409, 410, 422, 503)},
)
async def read_model_picture(session: ReadSession, index: Index, services: ServicesDep) -> Response:
    """What the frame should look like by the best pose: paint, light and blur as they explain it best."""
    return await _picture(session, index, services, "model")


@router.get(
    "/estimates/{index}/residual.png",
    response_class=Response,
    responses={**bytes_answered("image/png"), **problems(404, 409, 410, 422, 503)},
)
async def read_residual(session: ReadSession, index: Index, services: ServicesDep) -> Response:
    """The frame less `model.png`, both after the same low pass: orange where light is left, blue where it is missing.

    Full colour is half of what lies between black and white in `frame.png`.
    """
    return await _picture(session, index, services, "residual")


@router.get(
    "/estimates/{index}/frame.fits",
    response_class=Response,
    responses={**bytes_answered("image/fits"), **problems(404, 410, 422, 503)},
)
async def read_frame_fits(session: ReadSession, index: Index, services: ServicesDep) -> Response:
    """The frame with its best pose in `POSE_*` cards: the file that was sent where that was FITS, else a new one."""
    body = await services.archive.frame_fits(session, index)
    return Response(body, media_type="image/fits", headers={"Cache-Control": "private, max-age=86400"})


@router.get("/motion", response_model=PassMotion, responses=problems(404, 409, 503))
async def read_motion(session: ReadSession, services: ServicesDep) -> Response:
    """How the object turned, from all frames and all their modes: rate, axis and period, with their spreads.

    409 where the object is seen in fewer than three frames.
    """
    return _json(await services.archive.motion(session))


@router.get(
    "/report",
    response_class=Response,
    responses={200: {"content": {"text/html": {}}}, **problems(404, 409, 503)},
)
async def read_report(session: ReadSession, session_id: str, services: ServicesDep) -> Response:
    """The pass for people, as one HTML file: answer, pictures, motion, attitude, geometry, where it comes from.

    It loads nothing and holds no script. 409 before the first frame.
    """
    return report_file(await services.reports.of(session, release()), session_id)


@router.get(
    "/particles",
    response_class=Response,
    responses={200: {"content": {"application/json": {}, NPZ: {}}}, **problems(404, 410, 422)},
)
async def read_particles(
    session: ReadSession,
    request: Request,
    services: ServicesDep,
    query: Annotated[ParticlesQuery, Query()],
) -> Response:
    """The weighted particles after a frame, as JSON or (`Accept: application/x-npz`) as NumPy arrays."""
    found = await services.archive.particles(session, query.index)
    as_npz = NPZ in request.headers.get("accept", "")
    body = await asyncio.to_thread(_npz if as_npz else _particles_json, found, query.most)
    return Response(body, media_type=NPZ if as_npz else "application/json", headers={"Vary": "Accept"})


@router.get(
    "/export",
    response_class=Response,
    responses={200: {"content": {kind.media_type: {} for kind in FORMATS.values()}}, **problems(404, 409, 422)},
)
async def export(
    session_id: str, session: ReadSession, services: ServicesDep, query: Annotated[ExportQuery, Query()]
) -> Response:
    """The attitude history as a file. `aem`, `acm`, `apm`, `stk` and `czml` need frames with an absolute attitude."""
    kind = FORMATS[query.format]
    names: dict[str, Any] = {"name": query.object_name, "object_id": query.object_id}
    body = await services.archive.export(
        session, query.format, query.pose, **names, smoothed=query.smoothed, model=query.model
    )
    disposition = f'attachment; filename="{session_id}.{kind.suffix}"'
    return Response(body, media_type=kind.media_type, headers={"Content-Disposition": disposition})


def _npz(found: ParticleSet, most: int | None) -> bytes:
    buffer = io.BytesIO()
    names = np.array(found.joint_names, dtype=np.str_)
    np.savez(buffer, index=np.int64(found.index), joint_names=names, **found.arrays(most))
    return buffer.getvalue()


def _particles_json(found: ParticleSet, most: int | None) -> bytes:
    arrays = {name: np.ascontiguousarray(value) for name, value in found.arrays(most).items()}
    head = {"index": found.index, "orientation_order": ["w", "x", "y", "z"], "joint_names": found.joint_names}
    return orjson.dumps({**head, **arrays}, option=orjson.OPT_SERIALIZE_NUMPY)


async def _picture(
    session: ReadSession, index: int, services: ServicesDep, show: Literal["frame", "overlay", "model", "residual"]
) -> Response:
    (image,) = await services.archive.pictures(session, index, (show,))
    return Response(image, media_type="image/png", headers={"Cache-Control": "private, max-age=86400"})


def _json(document: bytes) -> Response:
    return Response(document, media_type="application/json")
