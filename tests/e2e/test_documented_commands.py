"""Commands of the documents that take seconds on any machine are run, as they stand there, on one service.

The others are held to what can be typed (tests/test_commands.py); README, tutorial and client are run elsewhere.
"""

import re
import shlex
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import click
import httpx
import pytest
import typer
from click.testing import Result
from passes import PNG, begin, fake_pass
from server_process import Server
from typer.testing import CliRunner

from service.cli import app

sys.path.append(str(Path(__file__).resolve().parents[1]))
from test_commands import ROOT, commands

FRAMES = 2
RUN = {
    "operations": (
        "skypose doctor",
        "skypose verify",
        "skypose sessions prune --older-than 90",
        "skypose backup skypose-$(date +%F).sqlite3",
        "skypose backup pass.sqlite3",
        "skypose restore pass.sqlite3 --data skypose-data",
    ),
    "report": ("skypose report SESSION",),
    "passes": ("skypose simulate --random 3 --out passes",),
    "security": (
        'skypose keys create --role admin --name "me"',
        "skypose keys create --role operate --tenant acme --name dome-2",
        "skypose keys create … --calls-per-s 50 --megabytes-per-s 20 --megapixels-per-s 10",
        "skypose keys list",
        "skypose keys revoke 1f0c9a3e",
    ),
}


@dataclass(frozen=True)
class Place:
    """A service with a session, and a folder to type in."""

    session_id: str
    data: Path
    folder: Path


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    found = Server(tmp_path_factory.mktemp("documents") / "data", "fake_worker:FakeWorker")
    found.start()
    yield found
    found.stop()


@pytest.fixture(scope="module")
def place(server: Server, tmp_path_factory: pytest.TempPathFactory) -> Place:
    given = fake_pass(FRAMES)
    with httpx.Client(base_url=server.url, timeout=60) as http:
        session_id = begin(http, given, name="body.glb")
        for n, image in enumerate(given.frames):
            http.put(f"/v1/sessions/{session_id}/frames/{n}", content=image, headers=PNG).raise_for_status()
    return Place(session_id, server.data, tmp_path_factory.mktemp("typed"))


@pytest.fixture
def typed(server: Server, place: Place, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Result]:
    """Run words of a command beside the service, whose data directory and address are in the environment."""
    monkeypatch.chdir(place.folder)
    monkeypatch.setenv("SKYPOSE_DATA_DIR", str(place.data))
    monkeypatch.setenv("SKYPOSE_URL", server.url)

    def run(*words: str) -> Result:
        done = CliRunner().invoke(app, list(words))
        assert done.exit_code == 0, f"{words}: {done.output}\n{done.exception!r}"
        return done

    return run


@pytest.mark.parametrize("name", RUN)
def test_the_commands_of_a_page_run(name: str, typed: Callable[..., Result], place: Place) -> None:
    on_page = {" ".join(line.split("  #")[0].split()): line for line, _ in commands(ROOT / "docs" / f"{name}.md")}
    for command in RUN[name]:
        here = re.sub(r"\$\([^)]*\)", "2026-11-23", on_page[command])  # raises where the page has it no more
        words = [word for word in shlex.split(here, comments=True)[1:] if word != "…"]
        if "…" in command:
            words += ["--role", "read", "--name", "slow"]
        if "revoke" in words:
            words[-1] = typed("keys", "list").stdout.splitlines()[1].split()[0]  # below the names of the columns
        typed(*(place.session_id if word == "SESSION" else word for word in words))
    made = {"operations": "skypose-data/skypose.sqlite3", "passes": "passes/pass_002/truth.csv"}
    assert (place.folder / made.get(name, ".")).exists()


def test_every_command_tells_what_it_takes(typed: Callable[..., Result]) -> None:
    """`skypose COMMAND --help`, as docs/cli.md says."""

    def paths(command: click.Command, *above: str) -> Iterator[tuple[str, ...]]:
        yield above
        for name, below in getattr(command, "commands", {}).items():
            yield from paths(below, *above, name)

    for path in paths(typer.main.get_command(app)):
        assert "Usage: " in typed(*path, "--help").stdout
