"""Takes the pictures of docs/images anew: ``.venv/bin/python tests/page/pictures.py``; needs Chromium, a minute or two.

A pass over Vienna is simulated, tracked by a service of its own, and looked at in its middle, its truth beside it.
"""

import csv
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

sys.path += [str(Path(__file__).resolve().parents[2]), str(Path(__file__).resolve().parents[1] / "e2e")]
from conftest import ARGUMENTS, CHROMIUM
from playwright.sync_api import Page, expect, sync_playwright
from server_process import ROOT, Server
from watching import picture_shows, shows

from service.client import Client, FrameFacts

TLE = """1 25544U 98067A   26324.50000000  .00016717  00000-0  10270-3 0  9009
2 25544  51.6400 208.9163 0006317  69.9862  25.2906 15.49815350 10000
"""
FRAMES, SHOWN = 18, 14
WIDE, PHONE = {"width": 1440, "height": 1520}, {"width": 390, "height": 844}


def simulate(folder: Path) -> Path:
    """A folder of frames, empty sky, pointing and truth."""
    (folder / "station.tle").write_text(TLE)
    given = ["--frames", str(FRAMES), "--site", "48.23,16.34,250", "--tle", str(folder / "station.tle")]
    command = [sys.executable, "-m", "service", "simulate", "--out", str(folder / "evening"), *given]
    subprocess.run([*command, "--time", "2026-11-21T17:30:42Z"], check=True, cwd=ROOT)
    return folder / "evening"


def track(url: str, given: Path) -> str:
    """Track all of it, site and orbit told; returns the session's id."""
    with Client(url) as client, (given / "pointing.csv").open() as pointing:
        told = {"site_latitude_deg": 48.23, "site_longitude_deg": 16.34, "site_height_m": 250.0}
        prior = {"orbit": TLE}
        model = client.upload_model(given / "demo.glb").model_id
        session = client.create_session(
            model, name="evening pass", joints={"free": "all"}, camera=told, prior=prior
        ).session_id
        for path in sorted((given / "background").iterdir()):
            client.add_background(session, path)
        for path, row in zip(sorted((given / "frames").iterdir()), csv.DictReader(pointing), strict=True):
            facts: FrameFacts = {
                "time": row["time"],
                "ra_deg": float(row["ra_deg"]),
                "dec_deg": float(row["dec_deg"]),
                "position_angle_deg": float(row["position_angle_deg"]),
            }
            client.post_frame(session, path, **facts)
    return session


def take(page: Page, name: str) -> None:
    """What the page shows, once its pictures stand, as a JPEG in docs/images."""
    picture_shows(page, SHOWN)
    page.wait_for_load_state("networkidle")
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    seen = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_COLOR)
    cv2.imwrite(str(ROOT / "docs" / "images" / name), seen, [cv2.IMWRITE_JPEG_QUALITY, 88])


def main() -> None:
    """Simulate, track, look."""
    with tempfile.TemporaryDirectory(prefix="skypose-") as name, sync_playwright() as playwright:
        given = simulate(Path(name))
        server = Server(Path(name) / "data")
        server.start()
        try:
            session = track(server.url, given)
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
            for size, picture in ((WIDE, "page.jpg"), (PHONE, "page-phone.jpg")):
                page = browser.new_context(viewport=size, timezone_id="UTC").new_page()
                page.goto(f"{server.url}/#{session}")
                shows(page, FRAMES - 1)
                page.set_input_files("#truth-file", given / "truth.csv")
                expect(page.locator("#compare")).to_have_value("truth")
                slider = page.get_by_role("slider", name="Frame")
                slider.fill(str(SHOWN))
                slider.blur()  # without the ring of the focus
                take(page, picture)
            browser.close()
        finally:
            server.stop()


if __name__ == "__main__":
    main()
