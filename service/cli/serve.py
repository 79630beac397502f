"""``skypose serve``: the service alone."""

from __future__ import annotations

import gc
import logging
import os
import socket
from collections.abc import Iterable, Iterator
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

import typer

from service.workers.interpreter import Interpreter

if TYPE_CHECKING:
    import uvicorn
    from fastapi import FastAPI

    from service.settings import Settings

_ALIKE = 0.8  # of two names, for the one to be the other misspelt


def serve(
    host: Annotated[str | None, typer.Option(help="Address to listen on.")] = None,
    port: Annotated[int | None, typer.Option(help="Port to listen on; 0 takes a free one.")] = None,
    data: Annotated[Path | None, typer.Option(help="Data directory.")] = None,
    workers: Annotated[int | None, typer.Option(help="Tracking processes.")] = None,
    engine: Annotated[Literal["process", "ray"] | None, typer.Option(help="What runs them.")] = None,
    address: Annotated[str | None, typer.Option(help="HOST:PORT of the Ray cluster.")] = None,
) -> None:
    """Run the service. What is not given comes from SKYPOSE_... or the defaults (docs/settings.md)."""
    gc.disable()  # until ``settle``: a collection in the middle of the imports finds nothing and takes its time
    given: dict[str, Any] = {"host": host, "port": port, "data_dir": data, "workers": workers}
    given |= {"engine": engine, "ray_address": address}
    # What a worker imports takes as long as all that this process does to start: side by side they take half.
    first = Interpreter("service.workers.guarded")
    run(_settings({name: value for name, value in given.items() if value is not None}), first=first)


def _settings(given: dict[str, Any]) -> Settings:
    from pydantic import ValidationError

    from service.settings import Settings

    try:
        settings = Settings(**given)
    except ValidationError as error:
        wrong = error.errors()[0]
        name = f"SKYPOSE_{'_'.join(map(str, wrong['loc'])).upper()}"
        _refuse(f"{name} is {wrong['input']!r}: {wrong['msg']}", error)
    for line in ignored(os.environ, Settings.model_fields):
        typer.echo(f"skypose serve: {line}", err=True)
    return settings


def ignored(environment: Iterable[str], known: Iterable[str]) -> Iterator[str]:
    """A line about each SKYPOSE_... variable that looks like a setting and is none."""
    names = [f"SKYPOSE_{name.upper()}" for name in known]
    for name in environment:
        near = get_close_matches(name, names, 1, _ALIKE)
        if name.startswith("SKYPOSE_") and name not in names and near:
            yield f"{name} is no setting and is ignored; did you mean {near[0]}?"


def require_free(host: str, port: int) -> None:
    """Exit with what to do where the port is taken."""
    family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(address)
        except OSError as error:
            _refuse(f"cannot listen on {host}, port {port}: {error.strerror}; --port takes another", error)


def run(settings: Settings, worker: str | None = None, first: Interpreter | None = None) -> None:
    """Serve until SIGINT or SIGTERM, then finish the frames in hand.

    ``worker`` names another than the tracker; ``first`` was started for one.
    """
    from service.cli import logs
    from service.errors import SkyposeError
    from service.workers.kernel import hide
    from service.workers.transports import open_transport

    logs.configure(settings.log_level, settings.log_format)
    if settings.decode_sandbox != "off":
        hide()  # from its decode process
    require_free(settings.host, settings.port)
    if settings.needs_credential:
        refuse_open_door(settings)
    try:
        transport = open_transport(settings.model_dump(), worker, first)
        transport.prestart()  # beside our own imports below
        from service.main import create_app

        app = create_app(settings, transport)
    except SkyposeError as error:
        _refuse(error.detail, error)
    logging.getLogger("uvicorn.error").addFilter(
        lambda record: not (app.state.refused and record.getMessage().startswith("Traceback"))
    )
    try:
        _server(app, settings).run()
    except SystemExit as error:  # uvicorn's, of a start that failed
        if app.state.refused is None:
            raise
        _refuse(app.state.refused, error)


def refuse_open_door(settings: Settings) -> None:
    """Exit with what to do, where others could reach the service and nobody would have a key."""
    import asyncio

    from service.access.gate import Gate
    from service.access.keys import Keys
    from service.access.provider import open_oidc
    from service.access.tickets import OwnTickets
    from service.errors import SkyposeError
    from service.store.choice import database_of

    async def look() -> None:
        database = database_of(settings)
        keys = Keys(database, settings.credential_cache_s)
        gate = Gate(settings, keys, open_oidc(settings), OwnTickets(settings.ticket_s))
        if not gate.needs_stored_key:
            return
        await database.open(beside=True)
        try:
            await gate.require_credentials()
        finally:
            await database.close()

    try:
        asyncio.run(look())
    except SkyposeError as error:
        _refuse(error.detail, error)


def _refuse(why: str, error: BaseException) -> NoReturn:
    typer.echo(f"skypose serve: {why}", err=True)
    raise typer.Exit(2) from error


def _server(app: FastAPI, settings: Settings) -> uvicorn.Server:
    import uvicorn

    from service.api.door import deepen, server_config

    class Server(uvicorn.Server):
        """Sends the watchers home first: uvicorn would wait for their endless answers."""

        async def startup(self, sockets: Any = None) -> None:
            await super().startup(sockets)
            deepen(self.servers)
            settle()

        def handle_exit(self, sig: int, frame: Any) -> None:
            app.state.services.hub.stop()
            super().handle_exit(sig, frame)

    config = server_config(
        app,
        host=settings.host,
        port=settings.port,
        timeout_graceful_shutdown=int(settings.shutdown_grace_s) or 1,
    )
    return Server(config)


def settle() -> None:
    """Take what was built at the start out of the garbage collector's sight, and let it run from now on.

    A full collection would walk all of it again and again, and stop the event loop for a tenth of a second; so would
    one here, before the first call, and the imports leave next to no garbage.
    """
    gc.freeze()
    gc.enable()
