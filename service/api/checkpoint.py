"""Routes of checkpoints."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request, Response

from service.api import schemas
from service.api.auth import Operator, ReadSession
from service.api.bodies import read_body
from service.api.description import bytes_answered, bytes_sent
from service.api.paging import problems
from service.api.services import ServicesDep

router = APIRouter(prefix="/v1/sessions/{session_id}/checkpoint", tags=["sessions"])
MEDIA_TYPE = "application/vnd.skypose.checkpoint"
_BODY = bytes_sent(f"What was read from a checkpoint. Its own `Content-Type` may be sent: `{MEDIA_TYPE}`.")


@router.get("", response_class=Response, responses={**bytes_answered(MEDIA_TYPE), **problems(404)})
async def read_checkpoint(session_id: str, session: ReadSession, services: ServicesDep) -> Response:
    """The session as one portable blob: model, configuration, background, particles, all estimates."""
    blob = await services.checkpoints.get(session)
    name = f'attachment; filename="{session_id}.skypose"'
    return Response(blob, media_type=MEDIA_TYPE, headers={"Content-Disposition": name})


@router.put(
    "",
    status_code=201,
    response_model=schemas.Session,
    responses={
        200: {"model": schemas.Session, "description": "An earlier stand of it was here"},
        **problems(409, 413, 422, 503),
    },
    openapi_extra=_BODY,
)
async def write_checkpoint(
    session_id: str, request: Request, response: Response, caller: Operator, services: ServicesDep
) -> dict[str, Any]:
    """Take a session in from another server; it goes on here with the next frame."""
    body, _ = await read_body(request)
    session, new = await services.checkpoints.put(caller.tenant, session_id, body)
    response.status_code = 201 if new else 200
    response.headers["Location"] = f"/v1/sessions/{session_id}"
    return session
