"""For everybody: keyboard, small screens, screen readers, and nothing that leaves the machine."""

import json
import re
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest
from fake_worker import CUBE
from passes import PNG, begin, fake_pass
from playwright.sync_api import expect
from watching import drop, open_session, picture_shows, shows, stage

AXE = Path(__file__).parent / "vendor" / "axe-core" / "axe.min.js"
FRAMES = 3
TLE = """1 25544U 98067A   26324.50000000  .00016717  00000-0  10270-3 0  9009
2 25544  51.6400 208.9163 0006317  69.9862  25.2906 15.49815350 10000"""


@pytest.fixture(scope="module")
def sessions(server):
    """Two sessions with a few frames, and a second model."""
    given = fake_pass(FRAMES)
    httpx.post(f"{server.url}/v1/models", files={"file": ("other.glb", CUBE + b" joint other")}).raise_for_status()
    with httpx.Client(base_url=server.url, timeout=60) as http:
        ids = [begin(http, given, name="body.glb") for _ in range(2)]
        for session_id in ids:
            for n, image in enumerate(given.frames):
                http.put(f"/v1/sessions/{session_id}/frames/{n}", content=image, headers=PNG).raise_for_status()
    return ids


@pytest.mark.parametrize("width", [1280, 820, 320])
def test_fits_its_screen_and_has_no_serious_accessibility_findings(server, sessions, open_page, width):
    page = open_page(f"{server.url}/#{sessions[0]}", width=width, height=844)
    shows(page, FRAMES - 1)
    expect(page.locator(f'[data-session="{sessions[0]}"]')).to_be_in_viewport(ratio=0.9)
    assert overflow(page) == 0
    page.keyboard.press("d")  # more of everything
    assert overflow(page) == 0
    assert findings(page) == []
    assert header_height(page, "live, looking at the past") == header_height(page, "live") < 64
    for name in ("Keyboard shortcuts", "New track"):
        expect(page.get_by_role("button", name=name)).to_be_visible()
    expect(page.get_by_role("link", name="API")).to_be_visible()
    page.get_by_role("button", name="New track").click()
    page.locator("select[name=model]").select_option(index=1)
    for details in ("Not sure which spacecraft it is?", "Telescope, site and orbit", "More settings"):
        page.get_by_text(details).click()
    assert findings(page) == []
    assert overflow(page) == 0
    page.keyboard.press("Escape")
    page.keyboard.press("?")
    expect(page.get_by_role("dialog", name="Keyboard")).to_be_visible()
    assert findings(page) == []


@pytest.mark.parametrize("width", [1440, 390])
def test_the_frames_tools_are_one_line_and_nothing_is_cut(server, sessions, open_page, width):
    page = open_page(f"{server.url}/#{sessions[0]}", width=width, height=900)
    shows(page, FRAMES - 1)
    tools = [page.locator(f"#frame .tools {one}").bounding_box() for one in ("label >> nth=0", ".save", ".video")]
    middles = [box["y"] + box["height"] / 2 for box in tools]
    assert max(middles) - min(middles) < 3
    legend = page.locator("#session > .legend")
    plot = page.locator(".strip .u-over").first
    plot.scroll_into_view_if_needed()
    plot.hover()
    expect(page.locator("#pointed")).to_contain_text("frame")
    assert legend.evaluate("(one) => one.scrollWidth - one.clientWidth") == 0
    assert legend.is_visible()
    page.keyboard.press("d")
    value = page.locator("#readout dd").first
    long = "1135.93, 1122.34 ± 10.25 px, 118.31 ± 10.037 px/unit"
    assert (
        value.evaluate("(one, text) => { one.textContent = text; return one.scrollWidth - one.clientWidth; }", long)
        == 0
    )


def overflow(page) -> int:
    """Pixels that the page is wider than its screen."""
    return page.evaluate("() => document.documentElement.scrollWidth - document.documentElement.clientWidth")


def header_height(page, says: str) -> float:
    """Of the page's head while the lamp says this."""
    page.evaluate("(says) => { document.querySelector('#link .text').textContent = says; }", says)
    return page.locator("#top").bounding_box()["height"]


def findings(page) -> list[str]:
    """Serious findings of axe-core, each with the elements."""
    page.evaluate(AXE.read_text() + "; null")
    found = page.evaluate("() => axe.run(document, { resultTypes: ['violations'] })")
    worst = [item for item in found["violations"] if item["impact"] in ("serious", "critical")]
    return [f"{item['id']}: {json.dumps([node['html'] for node in item['nodes']])}" for item in worst]


def test_keyboard(server, sessions, open_page):
    page = open_page(f"{server.url}/#{sessions[0]}")
    shows(page, FRAMES - 1)
    page.keyboard.press("?")
    help_dialog = page.get_by_role("dialog", name="Keyboard")
    expect(help_dialog).to_contain_text("one frame back, one on")
    page.keyboard.press("ArrowLeft")  # belongs to the dialog now
    page.keyboard.press("Escape")
    expect(help_dialog).to_be_hidden()
    shows(page, FRAMES - 1)
    page.keyboard.press("Home")
    shows(page, 0)
    page.keyboard.press("End")
    shows(page, FRAMES - 1)
    for key, name in (("m", "Modes"), ("o", "Outline")):
        page.keyboard.press(key)
        expect(page.get_by_role("button", name=name)).to_have_attribute("aria-pressed", "false")
    page.keyboard.press("z")
    expect(page.get_by_role("button", name="Zoom")).to_have_attribute("aria-pressed", "true")
    page.keyboard.press("d")
    for name in ("What the frame should look like", "What the model’s image leaves over"):
        expect(page.get_by_role("img", name=name)).to_be_visible()
    before = page.locator("#frame .stage").first.screenshot()
    page.keyboard.press("]")
    page.keyboard.press("c")
    expect(page.get_by_label("Contrast")).to_have_attribute("aria-valuetext", re.compile(r"^1\.41"))
    expect(page.get_by_label("Colours")).to_have_value("inverted")
    with page.expect_download() as download:
        page.keyboard.press("s")
    assert download.value.suggested_filename.endswith(f"-frame-{FRAMES - 1}.png")
    saved = cv2.imread(download.value.path())
    assert saved.shape[0] > 100 and np.median(saved) > 128  # as it is seen: a dark sky, inverted
    assert page.locator("#frame .stage").first.screenshot() != before
    with page.expect_download() as download:
        page.keyboard.press("e")
    video = cv2.VideoCapture(str(download.value.path()))
    images = [image for ok, image in iter(video.read, (False, None)) if ok]
    assert images and images[0].shape[1] > 100  # a browser that has no time leaves some out
    assert np.median(images[-1]) > 128  # the last frame, in the same colours
    expect(page.get_by_role("button", name="Video")).to_have_attribute("aria-pressed", "false")
    page.keyboard.press("r")
    expect(page.locator("#red")).to_be_visible()
    other = page.locator('#sessions [aria-current="true"]').get_attribute("data-session")
    page.keyboard.press("k")
    expect(page.locator(f'[data-session="{other}"]')).not_to_have_attribute("aria-current", "true")
    page.keyboard.press("n")
    expect(page.get_by_role("dialog", name="New track")).to_be_visible()


def test_the_models_image_is_that_of_the_frame_asked_for(server, sessions, open_page):
    """Also where the frame's own picture is still on its way."""
    page = open_page(f"{server.url}/#{sessions[0]}", hold="**/estimates/0/frame.png")
    picture_shows(page, FRAMES - 1)
    with page.expect_request("**/estimates/0/frame.png"):
        page.keyboard.press("Home")
    with page.expect_response("**/estimates/0/model.png"), page.expect_response("**/estimates/0/residual.png"):
        page.keyboard.press("d")
    for route in page.held:
        route.continue_()
    picture_shows(page, 0)


def test_a_models_image_that_takes_its_time_says_so(server, sessions, open_page):
    page = open_page(f"{server.url}/#{sessions[0]}", hold="**/model.png")
    picture_shows(page, FRAMES - 1)
    with page.expect_request("**/model.png"):
        page.keyboard.press("d")
    note = page.locator("#frame .stage.beside .note").first
    expect(note).to_have_text("being made…")
    for route in page.held:
        route.continue_()
    expect(note).not_to_have_text("being made…")


def test_plots_tell_values_and_are_zoomed(server, sessions, open_page):
    page = open_page(f"{server.url}/#{sessions[0]}")
    shows(page, FRAMES - 1)
    plot, value = page.locator(".strip .u-over").first, page.locator(".strip output").first
    whole = page.locator("#whole")
    found = httpx.get(f"{server.url}/v1/sessions/{sessions[0]}/estimates").json()["estimates"]
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    page.mouse.move(box["x"] + 1, box["y"] + 20)
    expect(page.locator("#pointed")).to_have_text(re.compile("^frame 0, 0.00 s"))
    expect(value).to_have_text(f"{found[0]['best']['yaw_deg']:.2f} °")
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] / 4, box["y"] + 20, steps=3)
    page.mouse.up()
    expect(whole).to_be_visible()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] - 200)
    expect(value).to_have_text(f"{found[-1]['best']['yaw_deg']:.2f} °")  # of the frame that is shown, again
    plot.click(position={"x": box["width"] / 2, "y": 20})  # within the part: its nearest frame
    shows(page, 0)
    whole.click()
    expect(whole).to_be_hidden()
    page.keyboard.press("+")
    expect(whole).to_be_visible()
    page.keyboard.press("0")
    expect(whole).to_be_hidden()


def test_another_session_or_a_truth_is_compared(server, sessions, open_page, tmp_path):
    page = open_page(f"{server.url}/#{sessions[0]}")
    shows(page, FRAMES - 1)
    page.get_by_label("Compare with").select_option(sessions[1])
    angle = page.locator("#plots figcaption").first
    expect(angle).to_have_text(re.compile(r"^Angle to .*0\.00 °$"))  # the same frames, the same seed
    assert page.url.endswith(f"#{sessions[0]}&with={sessions[1]}")
    page.reload()
    expect(angle).to_have_text(re.compile(r"^Angle to "))
    page.get_by_label("Compare with").select_option("nothing")
    expect(angle).to_have_text(re.compile("^Yaw"))
    expect(page.locator("#sky")).to_be_hidden()  # no orbit is known
    (tmp_path / "truth.csv").write_text("frame,qx,qy,qz,qw,x_px,y_px,scale_px\n" + f"{FRAMES - 1},1,0,0,0,5,5,1\n")
    drop(page, tmp_path / "truth.csv")  # alone: it is of the session that is shown
    expect(angle).to_have_text(re.compile(r"^Angle to truth1\d\d\.\d+ °$"))  # half a turn, but for some degrees
    expect(page.get_by_role("dialog")).to_have_count(0)


def test_sky_and_sun_are_shown_where_they_are_known(server, open_page):
    given = fake_pass(2)
    known = {
        "prior": {"orbit": TLE},
        "camera": {"site_latitude_deg": 48.23, "site_longitude_deg": 16.34},
        "light": {"sun": [0.6, 0.0, -0.8]},
    }
    with httpx.Client(base_url=server.url, timeout=60) as http:
        session_id = begin(http, given, name="body.glb", **known)
        for n, image in enumerate(given.frames):
            when = {"time": ("2026-11-21T17:30:40Z", "2026-11-21T17:31:00Z")[n]}  # the Earth's shadow lies between
            http.put(
                f"/v1/sessions/{session_id}/frames/{n}", content=image, headers=PNG, params=when
            ).raise_for_status()
    page = open_page(f"{server.url}/#{session_id}")
    shows(page, 1)
    expect(page.locator("#sky figcaption")).to_have_text(re.compile(r"elevation 26\.\d°, Sun -23\.\d°"))
    expect(page.locator("#readout .sky")).to_contain_text("in the Earth’s shadow")
    expect(page.locator("#model .light")).to_have_text("in the Earth’s shadow")
    page.keyboard.press("Home")
    expect(page.locator("#model .light")).to_have_text("lit by the Sun")
    for figure in ("#sky", "#model"):
        assert np.ptp(stage(page, figure)) > 100
    assert overflow(page) == 0
    assert findings(page) == []


def test_a_link_to_a_session_that_is_not_there_opens_no_other(server, sessions, open_page):
    page = open_page(f"{server.url}/#11111111-2222-4333-8444-555555555555", expect_failures=True)
    missing = page.locator("#missing")
    expect(missing).to_contain_text("11111111-2222-4333-8444-555555555555")
    expect(page.locator("#session")).to_be_hidden()
    expect(page.locator('#sessions [aria-current="true"]')).to_have_count(0)
    page.evaluate("(id) => { location.hash = id; }", sessions[0])  # as another link on the same page
    shows(page, FRAMES - 1)
    expect(missing).to_be_hidden()
    expect(page.locator(f'[data-session="{sessions[0]}"]')).to_have_attribute("aria-current", "true")


def test_every_control_is_reached_by_tab(server, sessions, open_page):
    page = open_page(f"{server.url}/#{sessions[0]}")
    shows(page, FRAMES - 1)
    page.locator("#new").focus()
    reached = set()
    for _ in range(60):
        reached.add(
            page.evaluate(
                "() => document.activeElement.id || document.activeElement.className"
                " || document.activeElement.closest('figure')?.id || ''"
            )
        )
        page.keyboard.press("Tab")
    assert {"new", "night", "export", "delete", "model", "cloud", "play", "live", "window"} <= reached


def test_save_and_delete(server, open_page):
    given = fake_pass(1)
    with httpx.Client(base_url=server.url, timeout=60) as http:
        session_id = begin(http, given, name="body.glb")
        http.put(f"/v1/sessions/{session_id}/frames/0", content=given.frames[0], headers=PNG).raise_for_status()
    page = open_page(server.url, expect_failures=True)
    open_session(page, session_id)
    shows(page, 0)
    with page.expect_download() as download:
        page.get_by_label("Save").select_option("csv")
    assert download.value.suggested_filename == f"{session_id}.csv"
    page.get_by_label("Save").select_option("aem")  # no pointing was given: the service says so
    expect(page.locator("#notices")).to_contain_text(re.compile("attitude", re.I))
    page.get_by_role("button", name="Delete…").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    expect(page.locator(f'[data-session="{session_id}"]')).to_have_count(0)
    assert httpx.get(f"{server.url}/v1/sessions/{session_id}").status_code == 404
