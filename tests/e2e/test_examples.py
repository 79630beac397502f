"""The examples of docs/examples, each run as a user would run it."""

import json
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import cv2
import numpy as np
import pytest
from api_client import image
from brahe.ccsds import AEM
from fake_worker import CUBE
from server_process import Server

from service.client import Client

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "examples"
START = "2026-11-20T03:04:05"


@pytest.fixture(scope="module")
def server(tmp_path_factory) -> Iterator[Server]:
    server = Server(tmp_path_factory.mktemp("examples") / "data", worker="fake_worker:FakeWorker")
    server.start()
    yield server
    server.stop()


def run(name: str, *arguments: object) -> str:
    command = [sys.executable, "-W", "error", str(EXAMPLES / name), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_example_is_run_here():
    tested = {"observatory_pass.py", "alpaca_bridge.py", "plot_track.py"}
    assert {path.name for path in EXAMPLES.glob("*.py")} == tested
    listed = (EXAMPLES / "README.md").read_text()
    assert all(f"({name})" in listed for name in tested)


@pytest.fixture
def folder(tmp_path) -> Path:
    (tmp_path / "sat.glb").write_bytes(CUBE + b"joint")
    for name, first, count in (("sky", 0, 2), ("frames", 5, 4)):
        (tmp_path / name).mkdir()
        for n in range(count):
            (tmp_path / name / f"{n:03d}.png").write_bytes(image(first + n))
    return tmp_path


def test_a_pass_is_posted_and_watched_and_plotted(server, folder):
    out = folder / "pass.csv"
    told = run(
        *("observatory_pass.py", folder / "sat.glb", folder / "sky", folder / "frames", "--url", server.url),
        *("--start", f"{START}Z", "--interval", 0.5, "--out", out),
    )
    assert [f"{START[:-1]}{5 + k // 2}.{500 * (k % 2):03d}Z" in told for k in range(4)] == [True] * 4
    assert out.read_text().count("\n") == 5
    with Client(server.url) as client:
        session_id = next(item.session_id for item in client.sessions() if item.name == "sat")
    figure = folder / "track.png"
    assert "4 frames" in run("plot_track.py", session_id, "--url", server.url, "--out", figure)
    assert cv2.imread(str(figure)).shape[0] > 1000


def test_pngs_give_an_attitude_file_with_a_pointing_and_a_table_without(server, folder):
    given = ("observatory_pass.py", folder / "sat.glb", folder / "sky", folder / "frames", "--url", server.url)
    told = run(*given, "--out", folder / "plain.aem")
    assert f"written: {folder / 'plain.csv'}" in told and (folder / "plain.csv").read_text().count("\n") == 5
    rows = [f"{k},{START}.{k}Z,{10 + k},20,0" for k in range(4)]
    (folder / "pointing.csv").write_text("frame,time,ra_deg,dec_deg,position_angle_deg\n" + "\n".join(rows))
    run(*given, "--pointing", folder / "pointing.csv", "--out", folder / "pass.aem")
    segments = AEM.from_str((folder / "pass.aem").read_text()).segments
    assert sum(len(segment.states) for segment in segments) == 4


class Dome(BaseHTTPRequestHandler):
    """A stand-in for an Alpaca server: a camera that is ready at the second look, and a mount that drifts."""

    looks = 0
    exposures = 0

    def do_GET(self) -> None:
        member = urlsplit(self.path).path.removeprefix("/api/v1/")
        dome = type(self)
        if member == "camera/0/imagearray":
            assert self.headers["Accept"] == "application/imagebytes"
            pixels = np.random.default_rng(dome.exposures).integers(0, 60_000, (16, 24), dtype=np.uint16)
            head = struct.pack("<11i", 1, 0, 1, 1, 44, 2, 8, 2, 24, 16, 0)
            self._answer(head + pixels.T.tobytes(), "application/imagebytes")
            return
        dome.looks += member == "camera/0/imageready"
        values = {
            "camera/0/imageready": dome.looks % 2 == 0,
            "camera/0/lastexposurestarttime": f"2026-11-20T03:04:{dome.exposures:02d}",
            "telescope/0/rightascension": 10.0 + dome.exposures / 100,
            "telescope/0/declination": -30.0,
            "telescope/0/equatorialsystem": 1,
        }
        self._value(values[member])

    def do_PUT(self) -> None:
        form = parse_qs(self.rfile.read(int(self.headers["Content-Length"])).decode())
        assert urlsplit(self.path).path == "/api/v1/camera/0/startexposure" and form["Duration"] == ["0.5"]
        type(self).exposures += 1
        self._value(None)

    def _value(self, value: object) -> None:
        document = {"Value": value, "ErrorNumber": 0, "ErrorMessage": ""}
        self._answer(json.dumps(document).encode(), "application/json")

    def _answer(self, body: bytes, media_type: str) -> None:
        self.send_response(200)
        self.send_header("Content-Type", media_type)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        """Nothing to standard error."""


def test_an_alpaca_camera_and_mount_feed_a_session(server):
    dome = ThreadingHTTPServer(("127.0.0.1", 0), Dome)
    threading.Thread(target=dome.serve_forever, daemon=True).start()
    with Client(server.url) as client:
        model = client.upload_model(CUBE, file_name="sat.glb")
        session = client.create_session(model.model_id, camera={"up_angle_deg": 3.0, "equinox": "date"}).session_id
        told = run(
            *("alpaca_bridge.py", "--alpaca", f"http://127.0.0.1:{dome.server_port}", "--url", server.url),
            *("--session", session, "--exposure", 0.5, "--poll", 0, "--background", 1, "--frames", 2),
        )
        assert "counts in" not in told and len(told.splitlines()) == 2
        first, second = client.estimates(session)
    dome.shutdown()
    dome.server_close()
    assert (first.time, second.time) == ("2026-11-20T03:04:02.250Z", "2026-11-20T03:04:03.250Z")
    assert first.best.attitude is not None and second.camera is not None
    assert second.best.attitude.angular_velocity_body_deg_s is not None
