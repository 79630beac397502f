"""``skypose report``: a pass, or an object over its passes, as one file for people."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import Annotated

import typer

from service.cli.remote_options import DEFAULT_URL, Key, Url, connected

_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")


def report(
    session: Annotated[str | None, typer.Argument(help="The session's id.")] = None,
    tracked: Annotated[str | None, typer.Option("--object", metavar="ID", help="Of an object.")] = None,
    out: Annotated[Path | None, typer.Option(help="File to write; by default the id with .html.")] = None,
    pdf: Annotated[bool, typer.Option("--pdf", help="A PDF beside it, printed by a Chromium on the PATH.")] = False,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Write the report of a pass, or of an object: one HTML file that loads nothing (docs/report.md)."""
    if (session is None) == (tracked is None):
        raise typer.BadParameter("give a session's id, or --object with an object's")
    browser = find_browser() if pdf else None
    if pdf and browser is None:
        typer.secho(f"--pdf needs one of {', '.join(_BROWSERS)} on the PATH", fg="red", err=True)
        raise typer.Exit(1)
    with connected(url, key) as client:
        body = client.object_report(tracked) if tracked is not None else client.report(str(session))
    path = out or Path(f"{tracked or session}.html")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(body)
    typer.echo(path)
    if browser is not None:
        typer.echo(printed(browser, path))


def find_browser() -> str | None:
    """A browser that prints without a window, if one is installed."""
    return next((found for name in _BROWSERS if (found := shutil.which(name))), None)


def printed(browser: str, page: Path) -> Path:
    """The page as PDF beside it. Raises ``typer.Exit`` where the browser fails, with what it said."""
    target = page.with_suffix(".pdf")
    rights = ["--no-sandbox"] if os.geteuid() == 0 else []  # Chromium's sandbox refuses to work for root
    command = [browser, "--headless", *rights, "--disable-gpu", "--no-pdf-header-footer"]
    done = subprocess.run(
        [*command, f"--print-to-pdf={target.absolute()}", page.absolute().as_uri()], capture_output=True, text=True
    )
    if done.returncode or not target.exists():
        typer.secho(f"{browser} printed no PDF: {done.stderr.strip()[-500:]}", fg="red", err=True)
        raise typer.Exit(1)
    return target
