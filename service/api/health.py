"""Routes for operators and probes: health, readiness, metrics, system, API documentation."""

from __future__ import annotations

from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

from fastapi import APIRouter, Response
from fastapi.openapi.docs import get_swagger_ui_html
from fastapi.responses import FileResponse, HTMLResponse
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest

from service.access.principal import DEFAULT_TENANT, tenant_of
from service.api import schemas
from service.api.auth import Reader
from service.api.paging import problems
from service.api.services import ServicesDep
from service.api.wire import Wire
from service.sessions.frame import format_time

router = APIRouter(tags=["operations"])
_ASYNCAPI = Path(__file__).with_name("asyncapi.yaml")
_NOT_SHOWN = {"data_dir", "database_url", "instance_url", "bootstrap_key_file", "oidc_jwks"}


def release() -> str:
    """Version of this program."""
    try:
        return version("skypose")
    except PackageNotFoundError:
        return "0.1.0+unpackaged"


class Health(Wire):
    """Whether the service lives or is ready."""

    status: Literal["ok", "starting"]
    checks: dict[str, bool]
    reasons: list[str]
    """What is not as it must be, for people."""


@router.get("/healthz", response_model=Health)
async def healthz() -> dict[str, Any]:
    """The event loop turns."""
    return {"status": "ok", "checks": {}, "reasons": []}


@router.get("/readyz", response_model=Health, responses={503: {"model": Health}})
async def readyz(response: Response, services: ServicesDep) -> dict[str, Any]:
    """Frames can be taken: the worker is up, the database takes writes, and its disk has room."""
    found = await services.status.checks()
    checks = {"worker": found.worker, "database": found.database}
    ready = all(checks.values())
    response.status_code = 200 if ready else 503
    return {"status": "ok" if ready else "starting", "checks": checks, "reasons": found.reasons}


@router.get("/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}}}, **problems()})
async def metrics(caller: Reader, services: ServicesDep) -> Response:
    """Prometheus metrics, counted over all tenants: for the operator's."""
    caller.require_operator()
    return Response(generate_latest(services.metrics.registry), media_type=CONTENT_TYPE_LATEST)


@router.get("/v1/system", response_model=schemas.System, responses=problems(503))
async def system(caller: Reader, services: ServicesDep) -> dict[str, Any]:
    """Devices, scorer, versions; processes and settings for the operator's tenant. Sessions are the caller's own."""
    operator = caller.tenant == DEFAULT_TENANT
    uptime = datetime.now(UTC) - services.started
    return {
        "name": "skypose",
        "version": release(),
        "started_at": format_time(services.started),
        "uptime_s": round(uptime.total_seconds(), 3),
        "worker": await services.status.worker(),
        "workers": services.status.processes() if operator else [],
        "sessions": sum(tenant_of(key) == caller.tenant for key in services.registry.resident),
        "settings": services.settings.model_dump(mode="json", exclude=_NOT_SHOWN) if operator else {},
    }


@router.get("/docs", include_in_schema=False)
async def docs() -> Response:
    """The API, to read and to try; served from here, without any other host."""
    return docs_page()


@router.get("/asyncapi.yaml", include_in_schema=False)
async def asyncapi() -> Response:
    """The stream, described as AsyncAPI."""
    return FileResponse(_ASYNCAPI, media_type="application/yaml")


def docs_page() -> HTMLResponse:
    """The page at ``/docs``, the same for everybody."""
    return get_swagger_ui_html(
        openapi_url="/openapi.json",
        title="skypose API",
        swagger_js_url="/static/vendor/swagger-ui/swagger-ui-bundle.js",
        swagger_css_url="/static/vendor/swagger-ui/swagger-ui.css",
        swagger_favicon_url="/static/favicon.svg",
    )
