"""``skypose doctor``: what this machine offers, and what is missing."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from service.settings import Settings


def doctor(
    data: Annotated[Path | None, typer.Option("--data", help="Data directory.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Check packages, OpenCL devices, the decode sandbox and the data directory. Exits 1 where tracking cannot run."""
    import orjson

    from service.settings import Settings

    settings = Settings() if data is None else Settings(data_dir=data)
    report: dict[str, Any] = {"python": sys.version.split()[0], "data_dir": str(settings.data_dir)}
    report["storage"] = _storage(settings)
    try:
        report["sandbox"] = _sandbox(settings)
        report["worker"] = _describe()
        report["ok"] = True
    except Exception as error:  # noqa: BLE001 -- whatever stops the worker is the diagnosis
        report["error"] = f"{type(error).__name__}: {error}"
        report["ok"] = False
    if report["ok"] and report["storage"]["error"] is not None:
        report |= {"ok": False, "error": f"nothing can be stored: {report['storage']['error']}"}
    if as_json:
        typer.echo(orjson.dumps(report, option=orjson.OPT_INDENT_2).decode())
    else:
        for line in _lines(report, settings.data_dir):
            typer.echo(line)
    raise typer.Exit(0 if report["ok"] else 1)


def _lines(report: Mapping[str, Any], data_dir: Path) -> Iterator[str]:
    """For people: what there is, one thing a line, and at the end whether tracking can run."""
    versions = report.get("worker", {}).get("versions", {})
    yield f"skypose {versions.get('skypose', '?')}, Python {report['python']}"
    storage = report["storage"]
    usable = "can be written" if storage["error"] is None else f"CANNOT BE USED ({storage['error']})"
    free = f"{storage['free_bytes'] / 2**30:.1f} GiB free (at least {storage['min_free_bytes'] / 2**30:.2f})"
    yield f"data directory {data_dir.absolute()}: {usable}, {free}"
    for device in report.get("worker", {}).get("devices", ()):
        why = f", not used: {device['rejected']}" if device["rejected"] else ""
        yield f"OpenCL {device['kind']}: {device['name']} ({device['platform']} {device['driver']}){why}"
    opengl = report.get("worker", {}).get("hand_over", {}).get("opengl")
    yield f"OpenGL: {opengl or 'none (only the backend opengl needs it)'}"
    if "sandbox" in report:
        from service.workers.sandbox import Sandbox

        yield f"decoding of what clients send: {Sandbox(**report['sandbox'])}"
    others = (f"{name} {number}" for name, number in versions.items() if name not in ("skypose", "python"))
    yield f"packages: {', '.join(others)}" if versions else "packages: not looked at"
    yield "tracking can run" if report["ok"] else f"tracking CANNOT run: {report['error']}"


def _storage(settings: Settings) -> dict[str, Any]:
    """Free bytes where the data directory is or would be, and why nothing can be stored there; None: it can.

    With PostgreSQL the frames are not on this disk, and a full one is no error.
    """
    from service.sessions.status import too_full
    from service.settings import MEBIBYTE
    from service.store.disk import Room, free_bytes

    folder, least = settings.data_dir.absolute(), settings.min_free_mb * MEBIBYTE
    held = next(one for one in (folder, *folder.parents) if one.exists())
    free = free_bytes(held)
    error = None if settings.database_url.get_secret_value() else too_full(Room(0, free), least)
    try:
        with TemporaryDirectory(dir=held) as made:
            (Path(made) / "written").write_bytes(b"skypose")
    except OSError as refused:
        error = refused.strerror or str(refused)
    return {"free_bytes": free, "min_free_bytes": least, "error": error}


def _sandbox(settings: Settings) -> dict[str, Any]:
    from service.workers.decode_process import DecodeProcess
    from service.workers.limits import DecodeLimits

    decoder = DecodeProcess(DecodeLimits.of(settings.model_dump()))
    try:
        return asdict(decoder.sandbox)
    finally:
        decoder.close()


def _describe() -> dict[str, Any]:
    from service.workers.tracker import Tracker

    tracker = Tracker()
    try:
        return dict(tracker.describe())
    finally:
        tracker.close()
