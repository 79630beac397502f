"""A session that goes to another process while it is in use."""

from __future__ import annotations

from typing import Annotated

import orjson
from pydantic import BaseModel, ConfigDict, Field
from starlette.responses import Response

from service.access.principal import public_id
from service.api.forwarding import Call
from service.api.services import Services
from service.api.wire import Wire
from service.errors import ConflictError, NotFoundError
from service.sessions.cluster import Cluster, Instance
from service.sessions.session import Session


class Moved(Wire):
    """A session that another process goes on with."""

    session_id: str
    process: str
    """Id of the process that has it now."""


class MoveQuery(BaseModel):
    """Where a session goes."""

    model_config = ConfigDict(extra="forbid", use_attribute_docstrings=True)

    to: Annotated[str, Field(max_length=64)] | None = None
    """Id of a process; by default the least busy other"""


async def move(services: Services, call: Call, to: str | None) -> Response:
    """Have the session's owner hand it over to the process ``to`` (None: the least busy of the others).

    Raises ``ConflictError`` where there is no other process, ``NotFoundError`` for one that is not there.
    """
    cluster = services.forwarding.cluster
    if cluster is None:
        raise ConflictError("one process serves this database: there is no other", setting="SKYPOSE_DATABASE_URL")
    owner = await services.registry.peer(call.session) or cluster.me
    target = await _target(cluster, owner, to)
    call.target = f"{call.target.partition('?')[0]}?to={target.id}"

    async def here(session: Session) -> Response:
        if target.id != cluster.me.id:
            await services.registry.hand_over(call.session, target.id)
        document = {"session_id": public_id(call.session), "process": target.id}
        return Response(orjson.dumps(document), media_type="application/json")

    return await services.forwarding.at_owner(call, here)


async def _target(cluster: Cluster, owner: Instance, to: str | None) -> Instance:
    live = await cluster.live()
    found = [one for one in live if (one.id == to if to is not None else one.id != owner.id)]
    if not found and to is not None:
        raise NotFoundError(f"no process {to}", field="query:to")
    if not found:
        raise ConflictError("there is no other process to take the session")
    return found[0]
