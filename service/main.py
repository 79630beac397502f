"""``create_app``: the one place that builds the rooms and wires them."""

from __future__ import annotations

import asyncio
import contextlib
import uuid
from collections.abc import AsyncIterator, Mapping
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import structlog
from fastapi import FastAPI
from starlette.middleware.cors import CORSMiddleware
from starlette.responses import FileResponse, Response
from starlette.staticfiles import StaticFiles

from service.access.audit import Audit
from service.access.gate import Gate
from service.access.keys import Keys
from service.access.limits import Limits
from service.access.peers import Peers
from service.access.provider import open_oidc
from service.access.stored import StoredBytes
from service.access.tickets import OwnTickets, SharedTickets
from service.api import (
    access,
    checkpoint,
    estimates,
    frames,
    health,
    models,
    objects,
    problems,
    schemas,
    sessions,
    stream,
)
from service.api.bodies import BodyLimits
from service.api.description import DescribedApi
from service.api.flow import Flow
from service.api.forwarding import Forwarding
from service.api.guard import Guard, page_policies
from service.api.observe import Observe
from service.api.services import Services
from service.api.submissions import Submissions
from service.ears import Ears
from service.errors import ConfigError, SkyposeError, StorageError
from service.housekeeping import Housekeeping
from service.metrics import Metrics
from service.sessions.admission import Admission, Places
from service.sessions.archive import Archive
from service.sessions.batch import Batches
from service.sessions.checkpoint import Checkpoints
from service.sessions.cluster import Cluster
from service.sessions.hub import Hub
from service.sessions.library import Library
from service.sessions.line import Line
from service.sessions.objects import Objects
from service.sessions.pruning import Pruning
from service.sessions.registry import Registry
from service.sessions.report import Reports
from service.sessions.session import Rooms
from service.sessions.status import Status
from service.settings import MEBIBYTE, Settings
from service.store.base import Quotas, Retention
from service.store.choice import database_of
from service.store.database import Database
from service.store.instances import Instance
from service.store.postgres import PostgresDatabase
from service.store.rules import Rules
from service.workers.engine import Engine, Transport
from service.workers.inspector import Inspector
from service.workers.limits import DecodeLimits
from service.workers.transports import open_transport

log = structlog.get_logger(__name__)
VIEWER = Path(__file__).parent / "viewer"


def create_app(settings: Settings, transport: Transport | None = None) -> FastAPI:
    """The application. ``transport`` replaces worker processes with the tracker, started with the application."""
    limits = DecodeLimits.of(settings.model_dump())
    engine = Engine(transport or open_transport(settings.model_dump()))
    me = Instance(str(uuid.uuid4()), settings.own_url)
    database = database_of(settings, me.id)
    inspector = Inspector(limits)
    services = _build(settings, engine, database, inspector, me)
    app = DescribedApi(
        title="skypose",
        version=health.release(),
        summary="Spacecraft pose from telescope video, by a particle filter on silhouettes",
        docs_url=None,
        redoc_url=None,
        lifespan=partial(_lifespan, services, engine, database, inspector),
    )
    app.state.services, app.state.refused = services, None
    problems.install(app)
    for room in (models, sessions, objects, frames, estimates, checkpoint, stream, access, health):
        app.include_router(room.router)
    app.add_middleware(BodyLimits, settings=settings)
    app.add_middleware(Flow, settings=settings)
    app.add_middleware(Guard, pages=page_policies(VIEWER, _docs_html()))
    _allow_origins(app, settings.allowed_origins.split())
    app.add_middleware(Observe)
    _serve_viewer(app)
    return app


def _build(settings: Settings, engine: Engine, database: Database, inspector: Inspector, me: Instance) -> Services:
    metrics = Metrics()
    hub = Hub(
        database,
        ring=settings.stream_ring_events,
        max_lag=settings.stream_max_lag_events,
        heartbeat_s=settings.stream_heartbeat_s,
        max_watchers=settings.max_streams,
        quota=settings.quota_streams,
    )
    retention = Retention(settings.keep_frame_bodies, settings.keep_particle_sets, settings.keep_particle_every)
    quotas = Quotas(settings.quota_sessions, settings.quota_models, settings.quota_particles)
    library = Library(database, engine, quotas)
    line = Line(settings.session_inbox_frames, settings.max_waiting_frames)
    rooms = Rooms(engine, inspector, database, hub, metrics, retention, line)
    registry = Registry(
        rooms,
        idle_s=settings.session_idle_s,
        max_resident=settings.max_resident_sessions,
        quotas=quotas,
        me=me.id if database.shared else None,
    )
    keys = Keys(database, settings.credential_cache_s, settings.quota_keys)
    tickets = SharedTickets(database, settings.ticket_s) if database.shared else OwnTickets(settings.ticket_s)
    forwarding = _forwarding(settings, database, me, Ears(hub, registry, keys), metrics)
    archive, status = Archive(database, engine), Status(database, engine, settings.min_free_mb * MEBIBYTE)
    return Services(
        settings=settings,
        metrics=metrics,
        hub=hub,
        registry=registry,
        pruning=Pruning(database, registry, Rules(settings.end_idle_days, settings.retain_ended_days)),
        library=library,
        archive=archive,
        objects=Objects(database, archive.motions, settings.quota_objects),
        reports=Reports(archive, library, status, settings.keep_frame_bodies),
        checkpoints=Checkpoints(database, registry, library, engine, _check_estimate),
        batch_places=Places(settings.max_batches, "SKYPOSE_MAX_BATCHES"),
        batches=Batches(registry, engine, inspector),
        status=status,
        admission=Admission(settings.max_pending_mb * MEBIBYTE, settings.quota_pending_mb * MEBIBYTE),
        submissions=Submissions(),
        forwarding=forwarding,
        gate=Gate(settings, keys, open_oidc(settings), tickets),
        keys=keys,
        tickets=tickets,
        limits=Limits(settings),
        stored=StoredBytes(database, settings.quota_stored_mb),
        audit=Audit(database, settings.audit_days, settings.audit_max_entries),
        started=datetime.now(UTC),
    )


def _forwarding(settings: Settings, database: Database, me: Instance, ears: Ears, metrics: Metrics) -> Forwarding:
    """Between the processes of one PostgreSQL database; with SQLite there is no other."""
    if not isinstance(database, PostgresDatabase):
        return Forwarding(ears.registry, metrics, None, None, 0.0)
    if settings.port == 0 and not settings.instance_url:
        raise ConfigError("with port 0 the other processes must be told how to reach it", field="SKYPOSE_INSTANCE_URL")
    cluster = Cluster(database, me, settings.lease_s, ears.heard, ears.resumed)
    patience_s = settings.database_wait_s + 2 * settings.lease_s
    return Forwarding(ears.registry, metrics, cluster, Peers(database, me.id, cluster.now), patience_s)


@contextlib.asynccontextmanager
async def _lifespan(
    services: Services, engine: Engine, database: Database, inspector: Inspector, app: FastAPI
) -> AsyncIterator[None]:
    async with contextlib.AsyncExitStack() as stack:
        try:
            await database.open()
            stack.push_async_callback(database.close)
            await services.gate.require_credentials()
            if services.settings.decode_sandbox == "required":
                await inspector.require_sandbox()
        except SkyposeError as error:
            app.state.refused = error.detail  # told in a line by the command
            raise
        stack.push_async_callback(_note_last_callers, services)
        stack.push_async_callback(engine.transport.close)
        stack.callback(inspector.close)
        await engine.transport.start()
        stack.push_async_callback(services.submissions.close)
        await stack.enter_async_context(_among_others(services.forwarding))
        stack.push_async_callback(services.registry.close)
        stack.callback(services.hub.stop)
        housekeeping = asyncio.create_task(Housekeeping(services, engine, database).run())
        stack.push_async_callback(_cancel, housekeeping)
        log.info("ready", version=app.version)
        yield
    log.info("stopped")


@contextlib.asynccontextmanager
async def _among_others(forwarding: Forwarding) -> AsyncIterator[None]:
    """Own sessions only within this, where several processes share the database."""
    if forwarding.cluster is None:
        yield
        return
    await forwarding.open()
    await forwarding.cluster.start()
    try:
        yield
    finally:
        await forwarding.cluster.stop()
        await forwarding.close()


async def _note_last_callers(services: Services) -> None:
    try:
        await services.audit.store(final=True)
    except StorageError as error:  # the end goes on: what is still in hand must be let go of
        log.error("the last entries of the audit log are not stored", error=error.detail)


async def _cancel(task: asyncio.Task[None]) -> None:
    task.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await task


def _docs_html() -> str:
    return bytes(health.docs_page().body).decode()


def _allow_origins(app: FastAPI, origins: list[str]) -> None:
    """Let pages of other sites read the answers, where the settings name them."""
    if origins:
        headers = ["Authorization", "Content-Type", "Idempotency-Key", "Prefer", "Last-Event-ID"]
        app.add_middleware(CORSMiddleware, allow_origins=origins, allow_methods=["*"], allow_headers=headers)


class PageFiles(StaticFiles):
    """Files of the page, asked for anew each time (304 where unchanged): scripts of two releases must not meet."""

    def file_response(self, *args: Any, **kwargs: Any) -> Response:
        """With the header that says so."""
        response = super().file_response(*args, **kwargs)
        response.headers["Cache-Control"] = "no-cache"
        return response


def _check_estimate(document: Mapping[str, Any]) -> None:
    schemas.Estimate.model_validate(document, strict=True)


def _serve_viewer(app: FastAPI) -> None:
    app.mount("/static", PageFiles(directory=VIEWER), name="static")

    @app.get("/", include_in_schema=False)
    async def page() -> Response:
        """The viewer."""
        return FileResponse(VIEWER / "index.html", headers={"Cache-Control": "no-cache"})
