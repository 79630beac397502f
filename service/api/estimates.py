"""Routes that read what was tracked: estimates, overlay, particles, export."""

from __future__ import annotations

import asyncio
import csv
import io
from typing import Annotated

import numpy as np
import orjson
from fastapi import APIRouter, Path, Query, Request, Response

from service.api import schemas
from service.api.paging import next_page, page_limit, page_response, problems
from service.api.services import ServicesDep
from service.errors import InputError
from service.sessions.archive import EVERYTHING, particle_arrays

router = APIRouter(prefix="/v1/sessions/{session_id}", tags=["estimates"])
EXPORT_FORMATS = ("csv",)
NPZ = "application/x-npz"
Index = Annotated[int, Path(ge=0, le=2**53)]


@router.get("/estimates", response_model=schemas.EstimateList, responses=problems(404, 422))
async def list_estimates(
    session_id: str,
    services: ServicesDep,
    after: Annotated[int, Query(ge=-1, le=2**53, description="Frames after this index")] = -1,
    limit: Annotated[int, Query(ge=1)] = 100,
) -> Response:
    """Estimates in order of their frames."""
    limit = page_limit(limit, services.settings)
    found, cursor = await services.archive.estimates(session_id, after, limit)
    following = next_page(f"/v1/sessions/{session_id}/estimates", cursor, limit)
    return page_response("estimates", found, following)


@router.get("/estimates/latest", response_model=schemas.Estimate, responses=problems(404))
async def latest_estimate(session_id: str, services: ServicesDep) -> Response:
    """The newest estimate."""
    return _json(await services.archive.estimate(session_id, None))


@router.get("/estimates/{index}", response_model=schemas.Estimate, responses=problems(404, 422))
async def read_estimate(session_id: str, index: Index, services: ServicesDep) -> Response:
    """The estimate of one frame."""
    return _json(await services.archive.estimate(session_id, index))


@router.get(
    "/estimates/{index}/overlay.png",
    response_class=Response,
    responses={200: {"content": {"image/png": {}}}, **problems(404, 410, 422, 503)},
)
async def read_overlay(session_id: str, index: Index, services: ServicesDep) -> Response:
    """The frame with the best silhouette in blue (the paper's Table 1)."""
    image = await services.archive.overlay(session_id, index)
    return Response(image, media_type="image/png", headers={"Cache-Control": "private, max-age=86400"})


@router.get(
    "/particles",
    response_class=Response,
    responses={200: {"content": {"application/json": {}, NPZ: {}}}, **problems(404, 410, 422)},
)
async def read_particles(
    session_id: str,
    request: Request,
    services: ServicesDep,
    index: Annotated[int | None, Query(ge=0, le=2**53, description="Frame; the newest by default")] = None,
) -> Response:
    """The weighted particles after a frame, as JSON or (`Accept: application/x-npz`) as NumPy arrays."""
    found, packed, names = await services.archive.particles(session_id, index)
    as_npz = NPZ in request.headers.get("accept", "")
    body = await asyncio.to_thread(_npz if as_npz else _particles_json, packed, found, names)
    return Response(body, media_type=NPZ if as_npz else "application/json", headers={"Vary": "Accept"})


@router.get(
    "/export",
    response_class=Response,
    responses={200: {"content": {"text/csv": {}}}, **problems(404, 422)},
)
async def export(
    session_id: str,
    services: ServicesDep,
    format: Annotated[str, Query(description="csv")] = "csv",  # noqa: A002
) -> Response:
    """The attitude history as a file."""
    if format not in EXPORT_FORMATS:
        raise InputError(
            f"format {format!r} is none of {', '.join(EXPORT_FORMATS)}",
            field="query:format",
            supported=list(EXPORT_FORMATS),
        )
    names = await services.archive.joint_names(session_id)
    found, _ = await services.archive.estimates(session_id, -1, EVERYTHING)
    body = await asyncio.to_thread(_csv, found, names)
    name = f'attachment; filename="{session_id}.csv"'
    return Response(body, media_type="text/csv", headers={"Content-Disposition": name})


def _npz(packed: bytes, index: int, names: tuple[str, ...]) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, index=np.int64(index), joint_names=np.array(names, dtype=np.str_), **particle_arrays(packed))
    return buffer.getvalue()


def _particles_json(packed: bytes, index: int, names: tuple[str, ...]) -> bytes:
    arrays = {name: np.ascontiguousarray(value) for name, value in particle_arrays(packed).items()}
    order = {"orientation_order": ["w", "x", "y", "z"], "joint_names": names}
    return orjson.dumps({"index": index, **order, **arrays}, option=orjson.OPT_SERIALIZE_NUMPY)


def _csv(documents: list[bytes], joints: tuple[str, ...]) -> str:
    buffer = io.StringIO()
    pose = ("x_px", "y_px", "scale_px", "yaw_deg", "pitch_deg", "roll_deg")
    writer = csv.writer(buffer)
    writer.writerow(
        ["index", "time", "status", "qw", "qx", "qy", "qz", *pose]
        + [f"joint:{name}" for name in joints]
        + ["orientation_spread_deg", "ess", "log_evidence"]
    )
    for estimate in map(orjson.loads, documents):
        best = estimate["best"]
        writer.writerow(
            [estimate["index"], estimate["time"], estimate["status"]]
            + [best["orientation"][axis] for axis in "wxyz"]
            + [best[name] for name in pose]
            + [best["joints"][name] for name in joints]
            + [estimate["spread"]["orientation_deg"], estimate["ess"], estimate["log_evidence"]]
        )
    return buffer.getvalue()


def _json(document: bytes) -> Response:
    return Response(document, media_type="application/json")
