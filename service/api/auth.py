"""Who calls, and may they: what every route declares.

A route takes ``Reader``, ``Operator`` or ``Admin`` (the ``Principal``, at least of that role), or, where its path names
a session, a model or an object, ``ReadSession``, ``OperateSession``, ``ReadModel`` and so on: the row's key, which only
that principal's tenant can make. A test holds every route to it.
"""

# No ``from __future__ import annotations`` here: FastAPI could not see the local names in them.

from collections.abc import Awaitable, Callable
from typing import Annotated

from fastapi import Depends
from starlette.requests import HTTPConnection

from service.access.gate import Shown
from service.access.peers import BODY_SHA256, FORWARDED, HEADER
from service.access.principal import ModelKey, ObjectKey, Principal, Role, SessionKey
from service.api.forwarding import target_of
from service.api.services import services_of

TICKETS_FOR = ("/stream", "/events")
PRINCIPAL = "principal"  # where a request's state keeps it, for the middlewares
ENTER = "enter"  # what a request's state has for whoever is admitted: takes the call's place, or refuses it


async def admit(connection: HTTPConnection) -> Principal:
    """Who calls, after one look at credentials, origin and rate; the call takes its place only then.

    Raises what the gate and the limits do, and ``BusyError``.
    """
    services = services_of(connection)
    headers = connection.headers
    peers, token = services.forwarding.peers, headers.get(HEADER)
    if (
        peers is not None and token is not None and connection.scope["type"] == "http"
    ):  # admitted and counted where it came in
        principal, body_sha256 = peers.verify(token, connection.scope["method"], target_of(connection))
        state = {PRINCIPAL: principal, FORWARDED: True, BODY_SHA256: body_sha256}
        connection.scope.setdefault("state", {}).update(state)
        _enter(connection, principal)
        return principal
    takes_tickets = connection.url.path.endswith(TICKETS_FOR)
    principal = await services.gate.admit(
        Shown(
            authorization=headers.get("authorization"),
            ticket=connection.query_params.get("ticket") if takes_tickets else None,
            host=headers.get("host", ""),
            origin=headers.get("origin"),
        )
    )
    connection.scope.setdefault("state", {})[PRINCIPAL] = principal
    services.limits.check(principal, "calls")
    services.limits.take(principal, "calls", 1)
    _enter(connection, principal)
    return principal


def _enter(connection: HTTPConnection, principal: Principal) -> None:
    enter = connection.scope["state"].get(ENTER)
    if enter is not None:  # not for a probe, nor for a WebSocket, which takes its place in the hub
        enter(principal)


def _of_role(role: Role) -> Callable[[Principal], Awaitable[Principal]]:
    async def principal_of_role(principal: Annotated[Principal, Depends(admit)]) -> Principal:
        principal.require(role)
        return principal

    return principal_of_role


def _session(role: Role) -> Callable[[str, Principal], Awaitable[SessionKey]]:
    async def session_of_tenant(
        session_id: str, principal: Annotated[Principal, Depends(_of_role(role))]
    ) -> SessionKey:
        return principal.session(session_id)

    return session_of_tenant


def _model(role: Role) -> Callable[[str, Principal], Awaitable[ModelKey]]:
    async def model_of_tenant(model_id: str, principal: Annotated[Principal, Depends(_of_role(role))]) -> ModelKey:
        return principal.model(model_id)

    return model_of_tenant


def _object(role: Role) -> Callable[[str, Principal], Awaitable[ObjectKey]]:
    async def object_of_tenant(object_id: str, principal: Annotated[Principal, Depends(_of_role(role))]) -> ObjectKey:
        return principal.object(object_id)

    return object_of_tenant


Reader = Annotated[Principal, Depends(_of_role(Role.READ))]
Operator = Annotated[Principal, Depends(_of_role(Role.OPERATE))]
Admin = Annotated[Principal, Depends(_of_role(Role.ADMIN))]
ReadSession = Annotated[SessionKey, Depends(_session(Role.READ))]
OperateSession = Annotated[SessionKey, Depends(_session(Role.OPERATE))]
ReadModel = Annotated[ModelKey, Depends(_model(Role.READ))]
OperateModel = Annotated[ModelKey, Depends(_model(Role.OPERATE))]
ReadObject = Annotated[ObjectKey, Depends(_object(Role.READ))]
OperateObject = Annotated[ObjectKey, Depends(_object(Role.OPERATE))]
