"""The ``skypose`` command: one module per subcommand. Heavy imports stay inside the commands."""

from __future__ import annotations

import typer

from service.cli.backup import backup, restore
from service.cli.bench import bench
from service.cli.demo import demo
from service.cli.doctor import doctor
from service.cli.export import export
from service.cli.ingest import ingest
from service.cli.keys import keys
from service.cli.model import model
from service.cli.motion import motion
from service.cli.openapi import openapi
from service.cli.plot import plot
from service.cli.report import report
from service.cli.serve import serve
from service.cli.sessions import sessions
from service.cli.simulate import simulate
from service.cli.track import track
from service.cli.verify import verify
from service.workers.interpreter import use_one_blas_thread

app = typer.Typer(name="skypose", no_args_is_help=True, pretty_exceptions_show_locals=False)
app.command()(serve)
app.command()(simulate)
app.command()(demo)
app.command()(track)
app.command("run")(track)
app.command()(doctor)
app.command()(ingest)
app.command()(export)
app.command()(motion)
app.command()(report)
app.command()(openapi)
app.command()(verify)
app.command()(backup)
app.command()(restore)
app.command()(plot)
app.add_typer(bench)
app.add_typer(keys)
app.add_typer(model)
app.add_typer(sessions)


def main() -> None:
    """Entry point of the ``skypose`` command."""
    use_one_blas_thread()  # as a worker has it: its own trackers' answers are the service's, bit for bit
    app()
