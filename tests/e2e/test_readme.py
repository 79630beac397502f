"""What the README tells a newcomer to type works, word for word."""

import json
import os
import re
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from astropy.io import fits
from brahe.ccsds import AEM

from service.cli.demo_service import ServiceProcess

FRAMES = 3
MADE = ".venv/bin/skypose simulate --out pass\n"  # the fixture makes a shorter one


@pytest.fixture(scope="module")
def blocks(root: Path) -> list[tuple[str, str]]:
    """The README's fenced blocks: language, text."""
    return re.findall(r"^```(\w+)\n(.*?)^```$", (root / "README.md").read_text(), flags=re.M | re.S)


@pytest.fixture(scope="module")
def port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(scope="module")
def folder(root: Path, port: int, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A checkout's folder as the README sees it, with a service running and a short pass to track."""
    folder = tmp_path_factory.mktemp("readme")
    binaries = folder / ".venv" / "bin"
    binaries.mkdir(parents=True)
    (binaries / "skypose").symlink_to(Path(sys.executable).parent / "skypose")
    simulate = ["simulate", "--out", "pass", "--frames", str(FRAMES)]
    subprocess.run([binaries / "skypose", *simulate], cwd=folder, check=True, capture_output=True, timeout=120)
    with ServiceProcess("127.0.0.1", port, folder):
        yield folder


def test_names_every_command(blocks: list[tuple[str, str]]) -> None:
    assert [language for language, _ in blocks] == ["bash", "python", "bash"]
    assert blocks[0][1].startswith(MADE)


@pytest.mark.skipif(shutil.which("jq") is None or shutil.which("curl") is None, reason="curl or jq not installed")
def test_curl(blocks: list[tuple[str, str]], folder: Path, port: int) -> None:
    help_text = subprocess.run(["curl", "--help", "http"], capture_output=True, text=True, check=True).stdout
    if "--json" not in help_text:
        pytest.skip("this curl is older than 7.82")
    script = blocks[0][1].removeprefix(MADE).replace(":8000", f":{port}")
    done = subprocess.run(["bash", "-e"], input=script, cwd=folder, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count('"orientation"') == FRAMES
    assert (folder / "overlay.png").read_bytes().startswith(b"\x89PNG")


def test_python(blocks: list[tuple[str, str]], folder: Path, port: int) -> None:
    script = blocks[1][1].replace(":8000", f":{port}")
    done = subprocess.run(
        [sys.executable, "-W", "error", "-"], input=script, cwd=folder, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == FRAMES


def test_the_client_page(root: Path, folder: Path, port: int) -> None:
    script, short = re.findall(r"^```python\n(.*?)^```$", (root / "docs" / "client.md").read_text(), flags=re.M | re.S)
    (folder / "pass" / "fits").mkdir()
    pixels = cv2.imread(str(folder / "pass" / "frames" / "000.png"), cv2.IMREAD_UNCHANGED)
    hdu = fits.PrimaryHDU(np.atleast_3d(pixels)[::-1, :, 0])
    hdu.header.update({"DATE-AVG": "2026-11-20T03:04:05", "RA": 10.0, "DEC": 20.0})
    hdu.writeto(folder / "pass" / "fits" / "000.fits")
    done = subprocess.run(
        [sys.executable, "-W", "error", "-"],
        input=(script + short).replace(":8000", f":{port}"),
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == f"frame-gap frame 99 is not the next; frame {FRAMES} is {FRAMES}"
    (segment,) = AEM.from_str((folder / "pass.aem").read_text()).segments
    assert [state.epoch.isostring() for state in segment.states] == ["2026-11-20T03:04:05Z"]


@pytest.mark.skipif(shutil.which("jq") is None or shutil.which("curl") is None, reason="curl or jq not installed")
def test_the_tutorial_and_its_notebook(root: Path, folder: Path, port: int) -> None:
    (folder / "docs").symlink_to(root / "docs")
    page = (root / "docs" / "tutorial.md").read_text()
    script = "".join(re.findall(r"^```bash\n(.*?)^```$", page, flags=re.M | re.S))
    url = f"http://127.0.0.1:{port}"
    for shown, here in (
        (":8000", f":{port}"),
        ("--frames 40", f"--frames {FRAMES}"),
        ("py evening", f"py --url {url} evening"),
    ):
        assert shown in script
        script = script.replace(shown, here)
    here = {**os.environ, "SKYPOSE_URL": url, "MPLBACKEND": "template"}
    here["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), here["PATH"]])
    done = subprocess.run(
        ["bash", "-e"], input=script, cwd=folder, capture_output=True, text=True, timeout=240, env=here
    )
    assert done.returncode == 0, done.stderr
    assert '"status": "tracking"' in done.stdout
    segments = AEM.from_str((folder / "evening.aem").read_text()).segments  # one where rates are known, one where not
    assert sum(len(segment.states) for segment in segments) > 0
    assert {path.name for path in (folder / "figures").iterdir()} == {"orientation.png", "corner.png", "residuals.png"}
    assert (folder / "evening.csv").stat().st_size > 0 and (folder / "evening.a").stat().st_size > 0

    cells = json.loads((root / "docs" / "notebook.ipynb").read_text())["cells"]
    code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code").replace(
        ":8000", f":{port}"
    )
    command = [sys.executable, "-W", "error", "-"]
    done = subprocess.run(command, input=code, cwd=folder, capture_output=True, text=True, timeout=240, env=here)
    assert done.returncode == 0, done.stderr
    found = re.search(r"median error ([\d.]+)°.*\nmedian error in GCRF ([\d.]+)°", done.stdout)
    assert found and all(float(error) < 5 for error in found.groups())


def test_ingest(root: Path, folder: Path, port: int) -> None:
    page = (root / "docs" / "cli.md").read_text()
    (command,) = re.findall(r"^    (skypose ingest .*)$", page, flags=re.M)
    for shown, here in (("/data/tonight", "pass/frames"), ("/data/sky", "pass/background"), ("satellite", "pass/demo")):
        command = command.replace(shown, here)
    command = f".venv/bin/{command} --once --json --url http://127.0.0.1:{port}"
    done = subprocess.run(["bash", "-e"], input=command, cwd=folder, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count('"orientation"') > FRAMES and len(done.stdout.splitlines()) == FRAMES


def test_offline(blocks: list[tuple[str, str]], folder: Path) -> None:
    done = subprocess.run(["bash", "-e"], input=blocks[2][1], cwd=folder, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert len((folder / "track" / "estimates.csv").read_text().splitlines()) == FRAMES + 1
    assert (folder / "track" / "contact_sheet.png").is_file()
