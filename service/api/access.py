"""Routes of those who call: who am I, tickets, keys, the audit log."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any, Literal

import orjson
from fastapi import APIRouter, Request, Response
from pydantic import Field

from service.access.keys import MAX_NAME
from service.access.principal import KeyRates, Role
from service.api.auth import Admin, Reader
from service.api.bodies import read_json
from service.api.paging import Page, page_limit, problems, stored_page
from service.api.services import ServicesDep
from service.api.wire import Wire

router = APIRouter(prefix="/v1", tags=["access"])
_NOT_SHOWN = {"sha256", "number", "tenant"}


class Me(Wire):
    """Whose credential it is."""

    tenant: str
    role: Literal["read", "operate", "admin"]
    key_id: str
    """Id of the API key; `oidc:…`, `bootstrap`, or `local` where none was needed."""


class Ticket(Wire):
    """For one WebSocket or event stream."""

    ticket: str
    expires_in_s: float


class RateLimits(Wire):
    """What a key may do in a second: 0 is any amount, null as the settings say."""

    calls_per_s: Annotated[float, Field(ge=0, le=1e9)] | None = None
    megabytes_per_s: Annotated[float, Field(ge=0, le=1e9)] | None = None
    """MiB of bodies."""
    megapixels_per_s: Annotated[float, Field(ge=0, le=1e9)] | None = None
    """Of frames and backgrounds."""


class KeyRequest(Wire):
    """A key to make, in the caller's tenant."""

    role: Literal["read", "operate", "admin"]
    name: Annotated[str, Field(min_length=1, max_length=MAX_NAME)]
    """For people: whose it is, what for."""
    days: Annotated[float, Field(gt=0, le=36500)] | None = None
    """How long it is good; without it, until it is revoked."""
    rates: RateLimits | None = None
    """Its own; a tenant's admin may only give less than the settings do."""


class ApiKey(Wire):
    """A key without its secret."""

    id: str
    role: Literal["read", "operate", "admin"]
    name: str
    created_at: str
    expires_at: str | None
    revoked_at: str | None
    last_used_at: str | None
    """To some minutes."""
    rates: RateLimits | None
    """Its own; without them those of the settings."""


class NewApiKey(ApiKey):
    """The only answer that shows the key."""

    key: str


class ApiKeyList(Wire):
    """A page of keys."""

    keys: list[ApiKey]
    damaged: list[str]
    """Ids of keys that are not as they were stored: none of them is taken."""
    next: str | None


class AuditEntry(Wire):
    """Who did what, when, and how it ended."""

    number: int
    at: str
    actor: str
    """Id of the key."""
    address: str
    action: str
    """Method and route."""
    target: str
    """What the route's path named."""
    outcome: int
    """HTTP status."""
    count: int
    """The same refusal so many times within a minute."""
    request_id: str


class AuditList(Wire):
    """A page of the audit log."""

    entries: list[AuditEntry]
    damaged: list[str]
    """Numbers of entries that are not as they were stored."""
    next: str | None


_KEY_SCHEMA = KeyRequest.model_json_schema(ref_template="#/components/schemas/{model}")
del _KEY_SCHEMA["$defs"]  # they are among the schemas of the answers
_KEY_BODY = {"requestBody": {"required": True, "content": {"application/json": {"schema": _KEY_SCHEMA}}}}


@router.get("/me", response_model=Me, responses=problems())
async def who_am_i(caller: Reader) -> dict[str, Any]:
    """Whose credential this call has, and what it may."""
    return {"tenant": caller.tenant, "role": caller.role.value, "key_id": caller.key_id}


@router.post("/tickets", status_code=201, response_model=Ticket, responses=problems())
async def make_ticket(caller: Reader, services: ServicesDep, response: Response) -> dict[str, Any]:
    """A ticket for one stream of a browser, which cannot send a key with it: `…/stream?ticket=…`."""
    response.headers["Cache-Control"] = "no-store"
    return {"ticket": await services.tickets.issue(caller), "expires_in_s": services.tickets.lifetime_s}


@router.post(
    "/keys", status_code=201, response_model=NewApiKey, responses=problems(413, 415, 422), openapi_extra=_KEY_BODY
)
async def create_key(request: Request, response: Response, caller: Admin, services: ServicesDep) -> dict[str, Any]:
    """A new key of the caller's tenant. This answer is the only one that shows it."""
    wanted = await read_json(request, KeyRequest)
    rates = KeyRates() if wanted.rates is None else KeyRates(**wanted.rates.model_dump())
    services.limits.require_grantable(caller, rates)
    record, text = await services.keys.create(caller.tenant, Role(wanted.role), wanted.name, wanted.days, rates)
    response.headers["Cache-Control"] = "no-store"
    response.headers["Location"] = f"/v1/keys/{record.id}"
    return {**_shown(asdict(record)), "key": text}


@router.get("/keys", response_model=ApiKeyList, responses=problems(422))
async def list_keys(caller: Admin, services: ServicesDep, query: Page) -> Response:
    """The tenant's keys, without their secrets, also those that are no longer good."""
    limit = page_limit(query.limit, services.settings)
    page = await services.keys.page(caller.tenant, query.after, limit)
    documents = [orjson.dumps(_shown(asdict(record))) for record in page.records]
    return stored_page("keys", documents, page.damaged, page.cursor, limit)


@router.delete("/keys/{key_id}", status_code=204, responses=problems(404))
async def revoke_key(key_id: str, caller: Admin, services: ServicesDep) -> None:
    """End a key of the caller's tenant, at once. It stays in the list."""
    await services.keys.revoke(caller.tenant, key_id)


@router.get("/audit", response_model=AuditList, responses=problems(422))
async def read_audit(caller: Admin, services: ServicesDep, query: Page) -> Response:
    """The tenant's audit log, the oldest entry first. Who showed no good credential is in that of `default`."""
    limit = page_limit(query.limit, services.settings)
    page = await services.audit.page(caller.tenant, query.after, limit)
    documents = [orjson.dumps({k: v for k, v in asdict(record).items() if k != "tenant"}) for record in page.records]
    return stored_page("entries", documents, page.damaged, page.cursor, limit, "/v1/audit")


def _shown(record: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in record.items() if name not in _NOT_SHOWN}
