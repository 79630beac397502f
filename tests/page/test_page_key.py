"""A service that wants keys: the page asks once, keeps the key for its tab, and brings tickets to the stream."""

import httpx
import pytest
from passes import PNG, begin, fake_pass
from playwright.sync_api import expect
from server_process import Server
from watching import is_live, picture_shows, shows

KEY = "the operator's first key, " + 32 * "k"


@pytest.fixture(scope="module")
def guarded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("guarded")
    (folder / "key").write_text(KEY)
    server = Server(folder / "data", "fake_worker:FakeWorker", auth="required", bootstrap_key_file=folder / "key")
    server.start()
    yield server
    server.stop()


def test_key_is_asked_for_and_opens_the_stream(guarded, open_page):
    given = fake_pass(2)
    with httpx.Client(base_url=guarded.url, timeout=60, headers={"Authorization": f"Bearer {KEY}"}) as http:
        session_id = begin(http, given, name="body.glb")
        put = f"/v1/sessions/{session_id}/frames"
        http.put(f"{put}/0", content=given.frames[0], headers=PNG).raise_for_status()
        page = open_page(guarded.url, expect_failures=True)
        dialog = page.get_by_role("dialog", name="API key")
        expect(dialog).to_be_visible()
        dialog.get_by_label("Key").fill("skypose_wrong_key")
        page.keyboard.press("Enter")
        expect(dialog).to_be_visible()  # refused: asked again
        dialog.get_by_label("Key").fill(KEY)
        page.keyboard.press("Enter")
        shows(page, 0)
        picture_shows(page, 0)
        is_live(page)
        http.put(f"{put}/1", content=given.frames[1], headers=PNG).raise_for_status()
        shows(page, 1)
        reader = http.post("/v1/keys", json={"role": "read", "name": "dome screen"}).json()["key"]
    assert KEY not in page.url
    page.reload()  # the tab still has it
    shows(page, 1)
    page.get_by_role("button", name="Change key").click()
    dialog.get_by_label("Key").fill(reader)
    page.keyboard.press("Enter")
    shows(page, 1)
    expect(page.get_by_role("button", name="New track")).to_be_hidden()


def test_without_a_key_nothing_is_shown_and_nobody_is_asked_twice(guarded, open_page):
    page = open_page(guarded.url, expect_failures=True)
    dialog = page.get_by_role("dialog", name="API key")
    expect(dialog).to_be_visible()
    page.keyboard.press("Escape")
    with page.expect_response(lambda answer: answer.url.endswith("/v1/sessions?limit=200") and answer.status == 401):
        pass
    expect(dialog).to_be_hidden()
    expect(page.locator("#sessions li")).to_have_count(0)
    page.get_by_role("button", name="Enter a key").click()
    expect(dialog).to_be_visible()
