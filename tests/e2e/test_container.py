"""The image: built as anybody would build it, its service answers and holds the bundled satellite's pass."""

import json
import os
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import httpx
import pytest

from service.cli.demo_pass import DemoPass, judge
from service.cli.model_file import read_model_file
from service.simulate.scenario import PRESETS
from service.simulate.sequence import SimulatedPass

TAG = "skypose-test"
FRAMES = 30
MOST_BYTES = 1.2e9
START_LIMIT_S = 120.0
STORAGE = {**os.environ, "BUILDAH_ISOLATION": "chroot", "STORAGE_DRIVER": "vfs"}

pytestmark = pytest.mark.timeout(1500)


def buildah(*arguments: str) -> str:
    return subprocess.run(
        ["buildah", *arguments], env=STORAGE, check=True, capture_output=True, text=True, timeout=300
    ).stdout


@pytest.fixture(scope="module")
def builder(shared: Path) -> Path:
    """The tool that builds without a Docker daemon."""
    tool = shared / "tools" / "build-image"
    missing = [name for name in ("buildah", "mmdebstrap") if shutil.which(name) is None]
    if not tool.is_file():
        missing.append(tool.name)
    if missing:
        pytest.skip(f"not installed: {', '.join(missing)}")
    if os.geteuid() != 0:
        pytest.skip("building an image takes root")
    return tool


@pytest.fixture(scope="module")
def image(builder: Path, root: Path) -> Iterator[str]:
    """The Dockerfile's image; removed afterwards, its base stays."""
    built = subprocess.run(
        [builder, root, TAG], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=1200
    )
    assert built.returncode == 0, built.stdout[-4000:]
    yield TAG
    buildah("rmi", f"localhost/{TAG}")


@pytest.fixture(scope="module")
def url(builder: Path, image: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A service started from the image."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    log = tmp_path_factory.mktemp("container") / "service.log"
    command = ["skypose", "serve", "--host", "127.0.0.1", "--port", str(port), "--data", "/data"]
    with log.open("wb") as sink:
        # A session of its own, so that the service, the shell around it and the container's set-up end together.
        process = subprocess.Popen(
            [builder, "--run", image, *command], stdout=sink, stderr=subprocess.STDOUT, start_new_session=True
        )
    try:
        wait_until_ready(f"http://127.0.0.1:{port}", process, log)
        yield f"http://127.0.0.1:{port}"
    finally:
        os.killpg(process.pid, signal.SIGTERM)
        process.wait(120)


def wait_until_ready(url: str, process: subprocess.Popen[bytes], log: Path) -> None:
    until = time.monotonic() + START_LIMIT_S
    while process.poll() is None and time.monotonic() < until:
        try:
            if httpx.get(f"{url}/readyz", timeout=2.0).status_code == httpx.codes.OK:
                return
        except httpx.TransportError:
            pass  # not listening yet
        time.sleep(0.2)
    pytest.fail(f"no service in the image:\n{log.read_text(errors='replace')[-4000:]}")


def test_is_small(image: str) -> None:
    manifest = json.loads(buildah("inspect", "--type", "image", "--format", "{{.Manifest}}", f"localhost/{image}"))
    assert sum(layer["size"] for layer in manifest["layers"]) < MOST_BYTES


def test_tracks_the_demo_pass(url: str) -> None:
    model = read_model_file("demo")
    scenario = PRESETS["demo"]()
    scenario = replace(scenario, motion=replace(scenario.motion, frames=FRAMES))
    client = DemoPass(url, model, SimulatedPass(model.mesh, model.articulation, scenario))
    try:
        client.open()
        results = list(client.track())
    finally:
        client.close()
    assert len(results) == FRAMES
    assert {result.answer["scorer"].split(":")[0] for result in results} == {"opencl"}
    assert judge(results).held
