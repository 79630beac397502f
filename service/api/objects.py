"""Routes of objects: what several sessions are of (docs/objects.md)."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response

from service.api.auth import OperateObject, Operator, Reader, ReadObject
from service.api.bodies import read_json
from service.api.health import release
from service.api.object_schemas import (
    ObjectMotion,
    ObjectPasses,
    ObjectRequest,
    ObjectSpin,
    PassQuery,
    TrackedObject,
    TrackedObjectList,
)
from service.api.paging import Page, page_limit, problems, stored_page
from service.api.report_file import report_file
from service.api.services import ServicesDep
from service.sessions.object_report import object_report

router = APIRouter(prefix="/v1/objects", tags=["objects"])
_REQUEST = {
    "requestBody": {
        "required": True,
        "content": {"application/json": {"schema": ObjectRequest.model_json_schema()}},
    }
}


@router.post(
    "",
    status_code=201,
    response_model=TrackedObject,
    responses=problems(404, 413, 415, 422, 429, 503),
    openapi_extra=_REQUEST,
)
async def create_object(
    request: Request, response: Response, caller: Operator, services: ServicesDep
) -> dict[str, Any]:
    """Name an object, so that sessions can be of it."""
    wanted = await read_json(request, ObjectRequest)
    made = await services.objects.create(caller.tenant, wanted.name, [caller.session(one) for one in wanted.sessions])
    response.headers["Location"] = f"/v1/objects/{made['object_id']}"
    return made


@router.get("", response_model=TrackedObjectList, responses=problems(422))
async def list_objects(
    caller: Reader,
    services: ServicesDep,
    query: Page,
) -> Response:
    """All objects in order of creation."""
    limit = page_limit(query.limit, services.settings)
    page = await services.objects.page(caller.tenant, query.after, limit)
    return stored_page("objects", page.records, page.damaged, page.cursor, limit)


@router.get("/{object_id}", response_model=TrackedObject, responses=problems(404))
async def read_object(held: ReadObject, services: ServicesDep) -> dict[str, Any]:
    """One object."""
    return await services.objects.get(held)


@router.delete("/{object_id}", status_code=204, responses=problems(404, 503))
async def delete_object(held: OperateObject, services: ServicesDep) -> None:
    """Forget an object. Its sessions stay."""
    await services.objects.remove(held)


@router.put("/{object_id}/sessions/{session_id}", response_model=TrackedObject, responses=problems(404, 503))
async def join_object(held: OperateObject, session_id: str, caller: Operator, services: ServicesDep) -> dict[str, Any]:
    """A session is of this object. It may be of several, and to say so again changes nothing."""
    return await services.objects.join(held, caller.session(session_id))


@router.delete("/{object_id}/sessions/{session_id}", status_code=204, responses=problems(404, 503))
async def leave_object(held: OperateObject, session_id: str, caller: Operator, services: ServicesDep) -> None:
    """It is of it no more."""
    await services.objects.leave(held, caller.session(session_id))


@router.get("/{object_id}/passes", response_model=ObjectPasses, responses=problems(404, 503))
async def read_object_passes(held: ReadObject, services: ServicesDep) -> dict[str, Any]:
    """When the object was seen, and by which sessions; those without a frame are of no pass."""
    return await services.objects.pass_list(held)


@router.get("/{object_id}/motion", response_model=ObjectMotion, responses=problems(404, 409, 422, 503))
async def read_object_motion(
    held: ReadObject,
    services: ServicesDep,
    query: Annotated[PassQuery, Query()],
) -> dict[str, Any]:
    """How the object turned in a pass, from the frames of all telescopes that saw it.

    Sessions of one pass are such as begin within half an hour of another's end. 409 unless all have one model, and the
    camera's orientation is known in every frame: only then do they tell of one attitude, body -> GCRF.
    """
    return await services.objects.motion(held, query.number)


@router.get("/{object_id}/spin", response_model=ObjectSpin, responses=problems(404, 409, 503))
async def read_object_spin(held: ReadObject, services: ServicesDep) -> dict[str, Any]:
    """Rate, period, axis and their trend over all passes, turns counted between passes where that is safe.

    409 unless a turning is seen against the stars in two passes.
    """
    return await services.objects.spin(held)


@router.get(
    "/{object_id}/report",
    response_class=Response,
    responses={200: {"content": {"text/html": {}}}, **problems(404, 409, 503)},
)
async def read_object_report(held: ReadObject, object_id: str, services: ServicesDep) -> Response:
    """The object for people, as one HTML file: spin over its passes with its trend, and what each pass says.

    It loads nothing and holds no script. 409 before the first frame.
    """
    return report_file(await object_report(services.objects, held, release()), object_id)
