"""``skypose ingest`` and ``skypose export`` against a running service."""

import csv
import io
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest
from api_client import image
from fake_worker import CUBE
from server_process import Server
from typer.testing import CliRunner

from service.cli import app
from service.cli.ingest_files import FilePoster
from service.client import Client


class Desk:
    """A folder that a camera fills, and the command on it."""

    def __init__(self, root: Path, url: str) -> None:
        self.root, self.url = root, url
        self.frames = root / "frames"
        self.frames.mkdir()
        (root / "sat.glb").write_bytes(CUBE + b"joint")
        (root / "sky.png").write_bytes(image())
        (root / "config.json").write_text(json.dumps({"camera": {"up_angle_deg": 5.0}, "joints": {"free": ["panel"]}}))

    def put(self, name: str, body: bytes) -> None:
        path = self.frames / name
        path.write_bytes(body)
        os.utime(path, (1e9, 1e9))  # complete long ago

    def run(self, *arguments: str):
        return CliRunner().invoke(app, [*arguments, "--url", self.url])

    def ingest(self, *more: str):
        begin = ["--mesh", str(self.root / "sat.glb"), "--background", str(self.root / "sky.png"), "--name", "dome"]
        config = ["--config", str(self.root / "config.json")]
        return self.run("ingest", "--watch", str(self.frames), "--once", "--json", *begin, *config, *more)


@pytest.fixture(scope="module")
def server(tmp_path_factory) -> Iterator[Server]:
    server = Server(tmp_path_factory.mktemp("ingest") / "data", worker="fake_worker:FakeWorker")
    server.start()
    yield server
    server.stop()


@pytest.fixture
def desk(server, tmp_path) -> Iterator[Desk]:
    yield Desk(tmp_path, server.url)
    for session in httpx.get(f"{server.url}/v1/sessions").json()["sessions"]:
        httpx.delete(f"{server.url}/v1/sessions/{session['session_id']}")


def estimates(result) -> list[dict]:
    return [json.loads(line) for line in result.stdout.splitlines()]


def stack(count: int) -> bytes:
    file = io.BytesIO()
    np.save(file, np.random.default_rng(5).integers(0, 255, (count, 16, 16), dtype=np.uint8))
    return file.getvalue()


def session_of(desk: Desk) -> dict:
    (session,) = httpx.get(f"{desk.url}/v1/sessions").json()["sessions"]
    return session


def test_a_folder_is_tracked_once_however_often_it_is_read(desk):
    for n in range(2):
        desk.put(f"f{n}.png", image(n))
    first = desk.ingest()
    assert (first.exit_code, [e["index"] for e in estimates(first)]) == (0, [0, 1]), first.output
    desk.put("f2.npy", stack(3))
    desk.put("f3.png", image(3))
    second = desk.ingest()
    assert [e["index"] for e in estimates(second)] == [2, 3, 4, 5]
    assert "4 frames tracked" in second.stderr
    third = desk.ingest()
    assert estimates(third) == []
    session = session_of(desk)
    assert (session["frames"], session["name"], session["joints"]["free"]) == (6, "dome", ["panel"])


def test_a_file_that_was_cut_off_in_the_middle_goes_on_there(desk):
    desk.put("f0.png", image(0))
    desk.ingest()
    desk.put("f1.npy", stack(4))
    with Client(desk.url) as client:
        poster = FilePoster(client, session_of(desk)["session_id"], file_times=False)
        begun = poster.post(desk.frames / "f1.npy", lambda path, error: pytest.fail(f"{path}: {error}"))
        assert next(begun).index == 1
        begun.close()
    told = estimates(desk.ingest())
    assert [e["index"] for e in told] == [1, 2, 3, 4] and told[0]["duplicate"]
    assert session_of(desk)["frames"] == 5


def test_killed_at_any_moment_it_goes_on(desk):
    for n in range(30):
        desk.put(f"f{n:02d}.png", image(n))
    command = [sys.executable, "-m", "service", "ingest", "--watch", str(desk.frames), "--once", "--json"]
    command += ["--url", desk.url, "--mesh", str(desk.root / "sat.glb")]
    command += ["--background", str(desk.root / "sky.png")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert json.loads(process.stdout.readline())["index"] == 0
        process.kill()
    again = desk.ingest()
    assert again.exit_code == 0, again.output
    page = httpx.get(f"{desk.url}/v1/sessions/{session_of(desk)['session_id']}/estimates").json()
    assert [estimate["index"] for estimate in page["estimates"]] == list(range(30))
    assert len(estimates(again)) < 30


def test_a_lost_note_and_a_broken_file(desk):
    desk.put("f0.png", image(0))
    desk.put("f1.png", image(1)[:40])
    desk.put("f2.png", image(2))
    result = desk.ingest()
    assert (result.exit_code, [e["index"] for e in estimates(result)]) == (1, [0, 1])
    assert "f1.png: " in result.stderr and "1 files refused" in result.stderr
    (desk.frames / ".skypose-ingest.json").unlink()
    session = session_of(desk)
    desk.put("f1.png", image(1))
    result = desk.ingest("--session", session["session_id"], "--file-times")
    assert [(e["index"], e["time"]) for e in estimates(result)] == [(2, "2001-09-09T01:46:40.000Z")]


def test_what_a_new_session_needs_is_said(desk):
    desk.put("f0.png", image(0))
    watch = ("ingest", "--watch", str(desk.frames), "--once")
    assert "--mesh" in (desk.run(*watch)).stderr
    mesh = ("--mesh", str(desk.root / "sat.glb"))
    assert "--border" in (desk.run(*watch, *mesh, "--border", "8", "--box", "1,2,3,4")).stderr
    note = desk.root / "nowhere" / "note.json"
    assert "--note" in desk.ingest("--note", str(note)).stderr
    note.parent.mkdir()
    note.write_text("{}")
    assert "names no session" in desk.ingest("--note", str(note)).stderr
    unknown = desk.run(*watch, "--session", "x")
    assert (unknown.exit_code, "not-found" in unknown.stderr) == (1, True)


def test_export_writes_what_the_service_answers(desk):
    desk.put("f0.png", image(0))
    desk.ingest()
    session = session_of(desk)
    result = desk.run("export", session["session_id"])
    assert [row["index"] for row in csv.DictReader(io.StringIO(result.stdout))] == ["0"]
    refused = desk.run("export", session["session_id"], "--format", "aem")
    assert (refused.exit_code, "409" in refused.stderr) == (1, True)
    out = desk.root / "track.npz"
    done = desk.run("export", session["session_id"], "--format", "npz", "--out", str(out))
    assert done.exit_code == 0 and np.load(out)["index"].tolist() == [0]


def test_sessions_are_listed_and_pruned(desk):
    desk.put("f0.png", image(0))
    assert desk.ingest().exit_code == 0
    session_id = session_of(desk)["session_id"]
    listed = desk.run("sessions", "list").stdout
    assert session_id in listed and "1 frames" in listed
    assert json.loads(desk.run("sessions", "list", "--json").stdout.splitlines()[-1])["session_id"]
    assert session_id not in desk.run("sessions", "prune", "--older-than", "1", "--yes").stdout
    told = desk.run("sessions", "prune", "--older-than", "0")
    assert session_id in told.stdout and "--yes" in told.stderr
    assert session_id in desk.run("sessions", "prune", "--older-than", "0", "--yes").stdout
    assert session_id not in desk.run("sessions", "list").stdout
