"""A pass that was interrupted goes on: the same folder again, what is tracked already left out."""

import httpx
import pytest
from passes import PNG, begin, fake_pass
from playwright.sync_api import expect
from watching import shows


@pytest.fixture
def folder(tmp_path):
    given = fake_pass(5)
    for n, image in enumerate(given.frames):
        (tmp_path / f"frame_{n}.png").write_bytes(image)
    return given, tmp_path


def test_frames_are_added_to_a_session(server, folder, open_page):
    given, files = folder
    with httpx.Client(base_url=server.url, timeout=60) as http:
        session_id = begin(http, given, name="body.glb")
        for n in range(2):
            http.put(f"/v1/sessions/{session_id}/frames/{n}", content=given.frames[n], headers=PNG).raise_for_status()
        page = open_page(f"{server.url}/#{session_id}")
        shows(page, 1)
        page.get_by_role("button", name="Add frames…").click()
        page.set_input_files("input[name=folder]", files)
        expect(page.get_by_role("checkbox", name="The first 2 are tracked already")).to_be_checked()
        page.get_by_role("button", name="Track 3 frames").click()
        shows(page, 4)
        again = http.put(f"/v1/sessions/{session_id}/frames/4", content=given.frames[4], headers=PNG)
        assert again.json()["duplicate"] is True


def test_a_session_without_sky_gets_it(server, folder, open_page):
    given, files = folder
    with httpx.Client(base_url=server.url, timeout=60) as http:
        model = http.post("/v1/models", files={"file": ("body.glb", given.mesh)}).json()
        session_id = http.post("/v1/sessions", json={"model_id": model["model_id"]}).json()["session_id"]
        page = open_page(f"{server.url}/#{session_id}")
        expect(page.locator("#status")).to_have_text("Needs empty sky")
        page.get_by_role("button", name="Add frames…").click()
        page.set_input_files("input[name=folder]", files)
        page.get_by_label("How many of the first frames show empty sky").fill("2")
        page.get_by_role("button", name="Track 3 frames").click()
        shows(page, 2)
        session = http.get(f"/v1/sessions/{session_id}").json()
    assert (session["background_frames"], session["frames"]) == (2, 3)
