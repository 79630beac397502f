"""Routes of sessions: create, list, read, delete."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response

from service.access.principal import tenant_of
from service.api import schemas
from service.api.auth import OperateSession, Operator, Reader, ReadSession
from service.api.bodies import read_json
from service.api.forwarding import Call
from service.api.moving import Moved, MoveQuery, move
from service.api.paging import Page, page_limit, problems, stored_page
from service.api.sections import SECTIONS
from service.api.services import ServicesDep

router = APIRouter(prefix="/v1/sessions", tags=["sessions"])
_REQUEST = {
    "requestBody": {
        "required": True,
        "content": {"application/json": {"schema": schemas.SessionRequest.model_json_schema()}},
    }
}


@router.post(
    "",
    status_code=201,
    response_model=schemas.Session,
    responses=problems(404, 413, 415, 422, 503),
    openapi_extra=_REQUEST,
)
async def create_session(
    request: Request, response: Response, caller: Operator, services: ServicesDep
) -> dict[str, Any]:
    """Begin a session for one object. The answer holds the whole effective configuration.

    With `model_ids` every frame is tracked under each model, and `models` of each estimate says how probable they are.
    """
    wanted = (await read_json(request, schemas.SessionRequest)).model_dump(exclude_none=True)
    sections = {name: wanted[name] for name in SECTIONS if name in wanted}
    if "background" in wanted:
        sections["camera"] = {**sections.get("camera", {}), "background": wanted["background"]}
    model_ids = wanted.get("model_ids") or [wanted["model_id"]]
    session = await services.registry.create(caller.tenant, model_ids, wanted.get("name"), sections)
    response.headers["Location"] = f"/v1/sessions/{session['session_id']}"
    return session


@router.get("", response_model=schemas.SessionList, responses=problems(422))
async def list_sessions(
    caller: Reader,
    services: ServicesDep,
    query: Page,
) -> Response:
    """All sessions in order of creation."""
    limit = page_limit(query.limit, services.settings)
    page = await services.archive.sessions(caller.tenant, query.after, limit)
    return stored_page("sessions", page.records, page.damaged, page.cursor, limit)


@router.get("/{session_id}", response_model=schemas.Session, responses=problems(404))
async def read_session(session: ReadSession, services: ServicesDep) -> dict[str, Any]:
    """One session."""
    return await services.archive.session(session)


@router.post("/{session_id}/move", response_model=Moved, responses=problems(404, 409, 422, 503))
async def move_session(
    session: OperateSession,
    caller: Operator,
    request: Request,
    services: ServicesDep,
    query: Annotated[MoveQuery, Query()],
) -> Response:
    """Give the session to another process of the cluster, after the frames that are waiting: none is lost."""
    return await move(services, Call.of(request, session, caller), query.to)


@router.delete("/{session_id}", status_code=204, responses=problems(404, 503))
async def delete_session(session: OperateSession, services: ServicesDep) -> None:
    """Delete a session with its whole history."""
    await services.registry.remove(session)
    services.stored.forget(tenant_of(session))
