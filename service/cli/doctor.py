"""``skypose doctor``: what this machine offers, and what is missing."""

from __future__ import annotations

import sys
from typing import Annotated, Any

import typer


def doctor(
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Check packages, OpenCL devices and the data directory. Exits 1 where tracking cannot run."""
    import orjson
    from rich.console import Console

    from service.settings import Settings

    settings = Settings()
    report: dict[str, Any] = {"python": sys.version.split()[0], "data_dir": str(settings.data_dir)}
    try:
        report["worker"] = _describe()
        report["ok"] = True
    except Exception as error:  # noqa: BLE001 -- whatever stops the worker is the diagnosis
        report["error"] = f"{type(error).__name__}: {error}"
        report["ok"] = False
    if as_json:
        typer.echo(orjson.dumps(report, option=orjson.OPT_INDENT_2).decode())
    else:
        Console().print(report)
    raise typer.Exit(0 if report["ok"] else 1)


def _describe() -> dict[str, Any]:
    from service.workers.tracker import Tracker

    tracker = Tracker()
    try:
        return dict(tracker.describe())
    finally:
        tracker.close()
