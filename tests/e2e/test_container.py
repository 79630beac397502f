"""The image: built as anybody would build it, its service answers and holds the bundled satellite's pass, and where the
machine allows mounts, with a root that nothing can write to."""

import json
import os
import re
import shutil
import subprocess
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import httpx
import pytest
from image_root import ImageRoot, buildah, can_mount, lasting_port, mounted, running

from service.cli.demo_pass import DemoPass, judge
from service.cli.model_file import read_model_file
from service.simulate.scenario import PRESETS
from service.simulate.sequence import SimulatedPass

TAG = "skypose-test"
FRAMES = 30
MOST_BYTES = 1.2e9
START_LIMIT_S = 120.0

pytestmark = [pytest.mark.timeout(1500), pytest.mark.long]


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
def files(image: str) -> Iterator[ImageRoot]:
    """The image's files."""
    with mounted(image) as found:
        yield found


@pytest.fixture(scope="module")
def url(builder: Path, files: ImageRoot, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A service started from the image; its root is read-only where mounts are allowed."""
    port = lasting_port()
    words = ["skypose", "serve", "--host", "127.0.0.1", "--port", str(port), "--data", "/data"]
    command = files.command(*words) if can_mount() else [str(builder), "--run", TAG, *words]
    log = tmp_path_factory.mktemp("container") / "service.log"
    with running(command, log) as process:
        wait_until_ready(f"http://127.0.0.1:{port}", process, log)
        yield f"http://127.0.0.1:{port}"


def wait_until_ready(url: str, process: "subprocess.Popen[bytes]", log: Path) -> None:
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


def test_tells_what_it_holds(files: ImageRoot, root: Path) -> None:
    document = json.loads((files.path / "usr" / "share" / "skypose" / "sbom.cdx.json").read_text())
    held = {component["purl"].partition("?")[0] for component in document["components"]}
    locked = re.findall(r"^([\w.-]+)==([^ ;\\]+)", (root / "requirements.lock").read_text(), flags=re.M)
    for name in ("numpy", "fastapi", "pyopencl"):
        assert f"pkg:pypi/{name}@{dict(locked)[name]}" in held
    debian = {purl.partition("@")[0] for purl in held}
    assert {"pkg:deb/debian/pocl-opencl-icd", "pkg:deb/debian/libegl1", "pkg:deb/debian/libc6"} <= debian


def test_nothing_can_write_to_its_root(files: ImageRoot) -> None:
    if not can_mount():
        pytest.skip("no mount namespace on this machine")
    for place in ("/usr/x", "/etc/x", "/opt/skypose/x", "/var/x"):
        refused = files.run("python3", "-c", f"open({place!r}, 'w')")
        assert "Read-only file system" in refused.stderr
    allowed = files.run("python3", "-c", "[open(d + '/x', 'w') for d in ('/tmp', '/data', '/var/cache/skypose')]")
    assert allowed.returncode == 0, allowed.stderr


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
    assert {result.answer["scorer"].split(":")[0] for result in results} == {"light"}
    assert judge(results).held
