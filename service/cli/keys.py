"""``skypose keys``: the API keys of a data directory, beside a running service or without one."""

from __future__ import annotations

import typing
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import typer

if typing.TYPE_CHECKING:
    from collections.abc import Callable

    from sqlalchemy import Connection

    from service.store.base import AuditRecord, KeyRecord

keys = typer.Typer(name="keys", no_args_is_help=True, help="API keys: create, list, revoke (docs/security.md).")
DataOption = Annotated[Path | None, typer.Option("--data", help="Data directory.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON.")]
RateOption = Annotated[float | None, typer.Option(min=0, help="Its own rate; 0 is any. Default: that of the settings.")]
_SHOWN = ("id", "tenant", "role", "name", "created_at", "expires_at", "revoked_at", "last_used_at", "rates")
_MOST, _WIDTH = 1_000_000, 180
R = TypeVar("R")


@keys.command()
def create(
    role: Annotated[Literal["read", "operate", "admin"], typer.Option(help="What it may do.")],
    name: Annotated[str, typer.Option(help="For people: whose it is, what for.")],
    tenant: Annotated[str, typer.Option(help="Whose models and sessions it sees.")] = "default",
    days: Annotated[float | None, typer.Option(min=0.001, max=36500, help="How long it is good.")] = None,
    calls_per_s: RateOption = None,
    megabytes_per_s: RateOption = None,
    megapixels_per_s: RateOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Make a key. Its text is printed once, and stored nowhere."""
    from service.access.keys import new_key
    from service.access.principal import KeyRates, Role
    from service.errors import ConfigError
    from service.store import api_keys, audit

    try:
        rates = KeyRates(calls_per_s, megabytes_per_s, megapixels_per_s)
        record, text = new_key(tenant, Role(role), name, days, rates)
    except ConfigError as error:
        raise typer.BadParameter(error.detail, param_hint=f"--{error.field}") from error

    def store(connection: Connection) -> None:
        api_keys.add(connection, record)
        audit.append(connection, [_entry(record.tenant, record.id, "skypose keys create")])

    _on_database(data, store)
    if as_json:
        _print_json({**_shown(record), "key": text})
    else:
        typer.echo(f"key {record.id} of tenant {tenant}, role {role}; it is shown only now:", err=True)
        typer.echo(text)


@keys.command("list")
def list_keys(
    tenant: Annotated[str | None, typer.Option(help="Only those of this tenant.")] = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show all keys, without their secrets."""
    from rich.console import Console
    from rich.table import Table

    from service.store import api_keys

    found = _on_database(data, lambda connection: api_keys.page(connection, tenant, 0, _MOST))
    for key_id in found.damaged:
        typer.echo(f"key {key_id} is not as it was stored and is not taken: revoke it and make another", err=True)
    if as_json:
        _print_json([_shown(record) for record in found.records])
        return
    table = Table(*_SHOWN, box=None)
    for record in found.records:
        table.add_row(*(str(value or "") for value in _shown(record).values()))
    Console(width=_WIDTH).print(table)


@keys.command()
def revoke(key_id: Annotated[str, typer.Argument(help="The key's id.")], data: DataOption = None) -> None:
    """End a key. A running service stops taking it within SKYPOSE_CREDENTIAL_CACHE_S."""
    from datetime import UTC, datetime

    from service.access.keys import utc_text
    from service.store import api_keys, audit

    def store(connection: Connection) -> None:
        tenant = api_keys.revoke(connection, None, key_id, utc_text(datetime.now(UTC)))
        audit.append(connection, [_entry(tenant, key_id, "skypose keys revoke")])

    _on_database(data, store)
    typer.echo(f"key {key_id} revoked", err=True)


def _on_database(data: Path | None, work: Callable[[Connection], R]) -> R:
    import asyncio

    from service.errors import SkyposeError
    from service.settings import Settings
    from service.store.choice import database_of

    async def run() -> R:
        database = database_of(Settings() if data is None else Settings(data_dir=data))
        try:
            await database.open(beside=True)
            return await database.write(work)
        finally:
            await database.close()

    try:
        return asyncio.run(run())
    except SkyposeError as error:
        typer.echo(error.detail, err=True)
        raise typer.Exit(1) from error


def _entry(tenant: str, key_id: str, action: str) -> AuditRecord:
    import getpass
    from datetime import UTC, datetime

    from service.access.keys import utc_text
    from service.store.base import AuditRecord

    now = utc_text(datetime.now(UTC))
    return AuditRecord(now, tenant, f"user {getpass.getuser()}", "-", action, key_id, 200)


def _shown(record: KeyRecord) -> dict[str, Any]:
    return {name: getattr(record, name) for name in _SHOWN}


def _print_json(value: object) -> None:
    import orjson

    typer.echo(orjson.dumps(value, option=orjson.OPT_INDENT_2).decode())
