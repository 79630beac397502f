"""A first-time user: an empty service, a folder on disk, and no code."""

import re
import subprocess
import sys
from pathlib import Path

import httpx
import numpy as np
import pytest
from playwright.sync_api import expect
from server_process import ROOT, Server
from watching import agree, open_session, picture_shows, shows, silhouette_of_service, silhouette_on_screen, stage

FRAMES = 8


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("files") / "pass"
    command = [
        sys.executable,
        "-m",
        "service",
        "simulate",
        "--out",
        str(out),
        "--frames",
        str(FRAMES),
        "--size",
        "128x128",
    ]
    subprocess.run(command, check=True, cwd=ROOT, capture_output=True)
    return out


@pytest.fixture(scope="module")
def tracker(tmp_path_factory):
    server = Server(tmp_path_factory.mktemp("first") / "data")
    server.start()
    yield server
    server.stop()


def test_from_an_empty_service_to_a_track(tracker, folder, open_page):
    page = open_page(tracker.url)
    page.get_by_role("button", name="Choose a folder").click()
    page.set_input_files("input[name=folder]", folder)
    facts = re.compile(rf"^{FRAMES} files, .* with truth.csv · 1 other file left out$")
    expect(page.locator(".frame-facts")).to_have_text(facts)
    expect(page.locator(".sky-facts")).to_have_text(re.compile("^10 files"))
    expect(page.get_by_role("checkbox", name=re.compile("^wing"))).to_be_checked()
    page.get_by_role("button", name=f"Track {FRAMES} frames").click()
    shows(page, FRAMES - 1)
    expect(page.locator("#title")).to_have_text("pass")
    expect(page.locator("#status")).to_have_text("Tracking")
    expect(page.locator("#sending")).to_be_hidden()

    session = httpx.get(f"{tracker.url}/v1/sessions").json()["sessions"][0]
    assert (session["frames"], session["background_frames"], session["joints"]["free"]) == (FRAMES, 10, ["wing"])
    estimate = httpx.get(f"{tracker.url}/v1/sessions/{session['session_id']}/estimates/latest").json()
    expect(page.locator("#readout dl").first).to_contain_text(f"{estimate['best']['yaw_deg']:.2f} ±")

    expect(page.locator("#compare")).to_have_value("truth")  # it was in the folder
    expect(page.locator("#plots figcaption").first).to_have_text(re.compile("^Angle to truth[0-9.]+ °$"))
    page.locator("#compare").select_option("nothing")  # its outline too is on the screen
    picture_shows(page, FRAMES - 1)
    seen = silhouette_on_screen(page)
    here = f"{tracker.url}/v1/sessions/{session['session_id']}"
    assert agree(seen, silhouette_of_service(here, FRAMES - 1, seen.shape)) > 0.97
    assert np.ptp(stage(page, "#model")) > 100
    assert np.ptp(stage(page, "#cloud")) > 100
    scrub(page)


def scrub(page) -> None:
    """Back through the pass: by slider, by keys, by a click into a plot, and to live again."""
    page.get_by_role("slider", name="Frame").fill("2")
    shows(page, 2)
    picture_shows(page, 2)
    expect(page.locator("#timeline output")).to_have_text(f"2 / {FRAMES - 1}")
    page.keyboard.press("ArrowRight")
    shows(page, 3)
    page.keyboard.press("Home")
    shows(page, 0)
    plot = page.locator(".strip .u-over").first
    plot.click(position={"x": plot.bounding_box()["width"] - 6, "y": 40})
    shows(page, FRAMES - 1)
    page.keyboard.press("Home")
    page.keyboard.press(" ")  # plays to the end
    shows(page, FRAMES - 1)
    page.get_by_role("button", name="Live").click()
    expect(page.get_by_role("button", name="Live")).to_have_attribute("aria-pressed", "true")


def test_outlines_are_seen_through_the_sessions_lens(tracker, folder, open_page):
    with httpx.Client(base_url=tracker.url, timeout=300.0) as client:
        with (folder / "demo.glb").open("rb") as file:
            model = client.post("/v1/models", files={"file": file}).json()["model_id"]
        camera = {"perspective": 140.0, "principal_point": [30.0, 64.0]}
        config = {"model_id": model, "camera": camera, "joints": {"free": ["wing"]}}
        here = f"/v1/sessions/{client.post('/v1/sessions', json=config).json()['session_id']}"
        png = {"Content-Type": "image/png"}
        for path in sorted((folder / "background").iterdir())[:3]:
            client.post(f"{here}/background", content=path.read_bytes(), headers=png)
        assert client.post(
            f"{here}/frames", content=(folder / "frames" / "000.png").read_bytes(), headers=png
        ).is_success
    page = open_page(tracker.url)
    open_session(page, here.rsplit("/", 1)[1])
    shows(page, 0)
    picture_shows(page, 0)
    seen = silhouette_on_screen(page)
    assert agree(seen, silhouette_of_service(tracker.url + here, 0, seen.shape)) > 0.95


def test_what_the_service_refuses_is_told(tracker, folder, tmp_path, open_page):
    page = open_page(tracker.url, expect_failures=True)
    page.keyboard.press("n")
    broken = tmp_path / "broken.glb"
    broken.write_bytes(b"not a mesh")
    page.set_input_files("input[name=mesh]", broken)
    problem = page.locator("#create .problem")
    expect(problem).to_contain_text("GLB")
    page.set_input_files("input[name=mesh]", folder / "demo.glb")
    expect(problem).to_be_hidden()

    odd = tmp_path / "odd"
    odd.mkdir()
    for n, path in enumerate(sorted((folder / "frames").iterdir())[:3]):
        (odd / path.name).write_bytes(path.read_bytes() if n < 2 else b"no picture")
    page.set_input_files("input[name=folder]", odd)
    page.get_by_role("radio", name=re.compile("^No empty frame: learn from a margin")).check()
    page.get_by_role("button", name="Track 3 frames").click()
    question = page.get_by_role("dialog", name="The service refused a file")
    expect(question).to_contain_text(Path(path).name)
    question.get_by_role("button", name="Leave it out").click()
    shows(page, 1)
