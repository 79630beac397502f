"""A start that cannot be is refused in one line that says what to do."""

import os
import subprocess
import sys

import pytest
from server_process import ROOT, Server

from service.cli.serve import ignored
from service.settings import Settings


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    server = Server(tmp_path_factory.mktemp("held") / "data", worker="fake_worker:FakeWorker")
    server.start()
    yield server
    server.stop()


def refused(*arguments: str, **environment: str) -> list[str]:
    command = [sys.executable, "-m", "service", "serve", *arguments]
    done = subprocess.run(
        command, cwd=ROOT, env={**os.environ, **environment}, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 2, done.stdout + done.stderr
    assert "Traceback" not in done.stdout + done.stderr
    return [line for line in done.stderr.splitlines() if line.startswith("skypose serve: ")]


def test_a_port_that_is_taken(server, tmp_path):
    port = server.url.rsplit(":", 1)[1]
    (line,) = refused("--port", port, "--data", str(tmp_path))
    assert f"port {port}" in line and "--port takes another" in line


def test_a_data_directory_that_is_in_use(server):
    (line,) = refused("--port", "0", "--data", str(server.data))
    assert line.endswith("is in use by another service")


def test_a_setting_of_another_kind(tmp_path):
    (line,) = refused("--data", str(tmp_path), SKYPOSE_WORKERS="many")
    assert "SKYPOSE_WORKERS is 'many'" in line


def test_a_misspelt_setting_is_told():
    names = ("SKYPOSE_PRT", "SKYPOSE_PORT", "SKYPOSE_SERVICE_HOST", "HOME")
    assert list(ignored(names, Settings.model_fields)) == [
        "SKYPOSE_PRT is no setting and is ignored; did you mean SKYPOSE_PORT?"
    ]
