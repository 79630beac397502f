"""``skypose doctor``: what a machine offers, as JSON, and a worker that cannot run."""

import json

from typer.testing import CliRunner

from gpu.device import find_devices
from service.cli import app
from service.workers.tracker import Tracker

RUNNER = CliRunner()


def test_devices_backends_and_the_hand_over_are_told():
    result = RUNNER.invoke(app, ["doctor", "--json"])
    assert result.exit_code == 0, result.output
    worker = json.loads(result.output)["worker"]
    assert [device["name"] for device in worker["devices"]] == [report.name for report in find_devices()]
    assert "outline" in worker["backends"]
    assert set(worker["hand_over"]) == {"name", "reason", "opengl"}


def test_what_stops_a_worker_is_the_diagnosis(monkeypatch):
    def broken(self):
        raise RuntimeError("the driver is broken")

    monkeypatch.setattr(Tracker, "describe", broken)
    result = RUNNER.invoke(app, ["doctor", "--json"])
    assert result.exit_code == 1
    assert json.loads(result.output)["error"] == "RuntimeError: the driver is broken"


def test_people_get_lines():
    result = RUNNER.invoke(app, ["doctor"])
    lines = result.stdout.splitlines()
    assert result.exit_code == 0 and lines[-1] == "tracking can run"
    assert lines[0].startswith("skypose ") and any("GiB free (at least 0.06)" in line for line in lines)
    assert any(line.startswith("OpenCL ") for line in lines) and "{" not in result.stdout
    (sandbox,) = (line for line in lines if line.startswith("decoding of what clients send: "))
    assert "dies with its parent, no core dumps, no capabilities, no new privileges" in sandbox


def test_a_data_directory_that_cannot_be_written_stops_tracking(monkeypatch):
    monkeypatch.setenv("SKYPOSE_DATA_DIR", "/proc/skypose")  # not even for root
    lines = RUNNER.invoke(app, ["doctor"])
    assert lines.exit_code == 1 and "CANNOT BE USED" in lines.stdout
    assert lines.stdout.splitlines()[-1].startswith("tracking CANNOT run: nothing can be stored")
    report = json.loads(RUNNER.invoke(app, ["doctor", "--json"]).output)
    assert report["storage"]["error"] and not report["ok"]


def test_a_data_directory_may_be_named_and_its_free_space_is_held_to_the_setting(monkeypatch, tmp_path):
    asked = ["doctor", "--data", str(tmp_path / "data")]
    assert f"data directory {tmp_path / 'data'}: can be written" in RUNNER.invoke(app, asked).stdout
    monkeypatch.setenv("SKYPOSE_MIN_FREE_MB", str(1 << 30))
    full = RUNNER.invoke(app, asked)
    assert full.exit_code == 1
    assert full.stdout.splitlines()[-1].endswith(f"SKYPOSE_MIN_FREE_MB asks for {1 << 30}")
    monkeypatch.setenv("SKYPOSE_DATABASE_URL", "postgresql://nobody@127.0.0.1/none")  # which is not asked
    assert RUNNER.invoke(app, asked).exit_code == 0
