"""From nothing to a track: ``.venv/bin/python tests/page/first_use.py``; prints seconds; needs Chromium, two minutes.

This checkout is cloned, set up and served as the README's first screen says, and a folder of FITS frames with a mesh,
without empty sky, is chosen on the page. It ends with 1 where the last frame is not `tracking`. What pip and Debian's
packages hold already is not fetched again: only a machine that has none of it shows all of the set-up.
"""

import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
from astropy.io import fits

sys.path += [str(Path(__file__).resolve().parents[2]), str(Path(__file__).resolve().parents[1] / "e2e")]
from conftest import ARGUMENTS, CHROMIUM
from playwright.sync_api import expect, sync_playwright
from server_process import ROOT, Server
from watching import shows

FRAMES = 24


def stranger(folder: Path) -> Path:
    """FITS frames that tell no more than their time, and the mesh."""
    command = [sys.executable, "-m", "service", "simulate", "--out", str(folder / "made"), "--frames", str(FRAMES)]
    subprocess.run(command, check=True, cwd=ROOT, capture_output=True)
    out = folder / "pass"
    out.mkdir()
    (folder / "made" / "demo.glb").rename(out / "demo.glb")
    for k, path in enumerate(sorted((folder / "made" / "frames").iterdir())):
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED).astype(np.uint16)
        header = fits.Header({"DATE-OBS": f"2026-11-21T17:30:{0.1 * k:06.3f}"})
        fits.PrimaryHDU(image, header).writeto(out / f"image_{k:03d}.fits")
    return out


def main() -> int:
    """Print when each step is done."""
    with tempfile.TemporaryDirectory() as made, sync_playwright() as playwright:
        given, clone = stranger(Path(made)), Path(made) / "skypose"
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        page = browser.new_page(viewport={"width": 1440, "height": 900})
        began = time.monotonic()

        def done(step: str) -> None:
            print(f"{time.monotonic() - began:6.1f} s  {step}", flush=True)

        subprocess.run(["git", "clone", "-q", str(ROOT), str(clone)], check=True)
        done("cloned")
        subprocess.run(["deploy/setup"], check=True, cwd=clone, capture_output=True)
        done("set up")
        server = Server(Path(made) / "data", checkout=clone)
        server.start()
        try:
            done("ready")
            page.goto(server.url)
            page.get_by_role("button", name="Choose a folder").click()
            page.set_input_files("input[name=folder]", given)
            page.get_by_role("button", name=f"Track {FRAMES} frames").click()
            done("frames chosen")
            expect(page.locator("html")).to_have_attribute("data-shown", re.compile("[0-9]"))
            done("first answer")
            shows(page, FRAMES - 1)
            done("last answer")
            status = page.locator("#status").inner_text()
        finally:
            server.stop()
            browser.close()
    print(status)
    return 0 if status == "Tracking" else 1


if __name__ == "__main__":
    sys.exit(main())
