"""``skypose ingest``: feed a running service from a folder that a camera program fills."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.cli.remote_options import DEFAULT_URL, Key, Url, connected

if TYPE_CHECKING:
    from service.api.schemas import Estimate
    from service.cli.ingest_session import SessionPlan
    from service.client import Client, RefusedError


def ingest(
    watch: Annotated[Path, typer.Option(exists=True, file_okay=False, help="Folder of frames.")],
    session: Annotated[str | None, typer.Option(help="Feed this session; by default the folder's own.")] = None,
    mesh: Annotated[Path | None, typer.Option(exists=True, help="For a new session: the mesh file.")] = None,
    background: Annotated[
        Path | None, typer.Option(exists=True, help="Empty sky: folder or file. Default: from the frames.")
    ] = None,
    box: Annotated[str | None, typer.Option(help="x,y,w,h: object in frame 1; background is outside.")] = None,
    border: Annotated[float | None, typer.Option(min=1, help="Background is this margin of frame 1, px.")] = None,
    joints: Annotated[str | None, typer.Option(help="Joint definitions: JSON array, or a JSON file.")] = None,
    config: Annotated[Path | None, typer.Option(help="Session's configuration: JSON file of its sections.")] = None,
    name: Annotated[str | None, typer.Option(help="Name of a new session.")] = None,
    once: Annotated[bool, typer.Option("--once", help="End when every file that is there has been tracked.")] = False,
    settle: Annotated[float, typer.Option(min=0, help="A file is complete after so many seconds unchanged.")] = 1.0,
    poll: Annotated[float, typer.Option(min=0.05, help="Seconds between two looks at the folder.")] = 0.5,
    file_times: Annotated[bool, typer.Option("--file-times", help="Files' times are the frames'.")] = False,
    note: Annotated[Path | None, typer.Option(help="Where the session is remembered.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print every estimate as a line of JSON.")] = False,
    url: Url = DEFAULT_URL,
    key: Key = None,
) -> None:
    """Track files as they appear in a folder, in the order of their names, each exactly once.

    May be ended and started again at any time: it goes on with the same session. Exits 1 if a file was refused.
    """
    from service.cli.ingest_session import NOTE, SessionPlan, read_config
    from service.cli.model_file import read_joint_list

    plan = SessionPlan(mesh, background, box, border, read_joint_list(joints), read_config(config), name)
    with connected(url, key, patient=True) as client:
        run = Ingest(client, watch, plan, session, note or watch / NOTE, file_times=file_times, as_json=as_json)
        try:
            run.follow(once=once, settle_s=settle, poll_s=poll)
        except KeyboardInterrupt:
            run.console.print("ended; start again to go on", style="yellow")
        finally:
            run.summary()
    raise typer.Exit(1 if run.refused else 0)


class Ingest:
    """One run over a folder."""

    def __init__(
        self,
        client: Client,
        folder: Path,
        plan: SessionPlan,
        session_id: str | None,
        note: Path,
        *,
        file_times: bool,
        as_json: bool,
    ) -> None:
        from rich.console import Console

        self.console = Console(stderr=True)
        self.refused: list[str] = []
        self.tracked = 0
        self._client, self._folder, self._plan, self._note = client, folder, plan, note
        self._session_id = session_id
        self._file_times, self._as_json = file_times, as_json

    def follow(
        self,
        *,
        once: bool,
        settle_s: float,
        poll_s: float,
        now: Callable[[], float] = time.time,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Post complete files until there are no more (``once``), or for ever."""
        from httpx import TransportError
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

        from service.cli.watched_folder import WatchedFolder

        files = WatchedFolder(self._folder, settle_s)
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[status]}"),
        )
        with Progress(*columns, console=self.console) as progress:
            task, done = progress.add_task("files", total=None, status="waiting"), 0
            while True:
                try:
                    for path in files.ready(now()):
                        progress.update(task, status=path.name)
                        for estimate in self.post(path):
                            progress.update(task, status=f"frame {estimate.index}: {estimate.status}")
                        files.take(path)
                        done += 1
                        progress.update(task, completed=done, total=done + files.waiting)
                except TransportError as error:
                    if once:
                        raise
                    progress.update(task, status=f"the service does not answer ({type(error).__name__}); trying on")
                if once and files.waiting == 0:
                    return
                sleep(poll_s)

    def post(self, path: Path) -> Iterator[Estimate]:
        """Track a file's frames, and tell of each as it comes."""
        from service.cli.ingest_files import FilePoster

        poster = FilePoster(self._client, self._session(path), file_times=self._file_times)
        for estimate in poster.post(path, self._refuse):
            self.tracked += not estimate.duplicate
            if self._as_json:
                typer.echo(estimate.model_dump_json())
            yield estimate

    def summary(self) -> None:
        """A line about the run."""
        session = self._session_id or "none begun"
        self.console.print(f"session {session}: {self.tracked} frames tracked, {len(self.refused)} files refused")

    def _session(self, first_frame: Path) -> str:
        from service.cli.ingest_session import begin_session, remember_session, remembered_session

        if self._session_id is None:
            self._session_id = remembered_session(self._client, self._note)
        if self._session_id is None:
            begun = begin_session(self._client, self._plan, first_frame)
            self._session_id = begun.session_id
            remember_session(self._note, self._session_id)
            self.console.print(f"session {self._session_id}")
            for warning in begun.warnings:
                self.console.print(f"[yellow]{warning}[/yellow]")
        return self._session_id

    def _refuse(self, path: Path, error: RefusedError) -> None:
        self.refused.append(path.name)
        self.console.print(f"[yellow]{path.name}: {error.detail}[/yellow]")
