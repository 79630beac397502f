"""A headless Chromium at a real server. Every page must load all of itself from that server and log no error."""

import re
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest

sys.path.append(str(Path(__file__).resolve().parents[1] / "e2e"))
from playwright.sync_api import Browser, Page, WebSocketRoute, expect, sync_playwright
from server_process import Server

expect.set_options(timeout=300_000)
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
# WebGL in software; root needs no sandbox to draw our own page.
ARGUMENTS = ["--no-sandbox", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage"]
DRIVER = "GL Driver Message (OpenGL, Performance"  # a word of this driver, which draws without a GPU


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """One Chromium for the tests of a file, closed after it: its event loop must not meet those of other tests."""
    if CHROMIUM is None:
        pytest.skip("no Chromium (Debian: apt-get install chromium)")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """The service over the fake worker, one for all files: a test makes its own sessions."""
    found = Server(tmp_path_factory.mktemp("page") / "data", "fake_worker:FakeWorker")
    found.start()
    yield found
    found.stop()


@pytest.fixture
def open_page(browser: Browser) -> Iterator[Callable[..., Page]]:
    """Opens pages of one width; at the end none may have logged an error or asked another host for anything."""
    contexts, problems = [], []

    def make(
        url: str,
        width: int = 1280,
        height: int = 800,
        expect_failures: bool = False,
        hold: str | re.Pattern[str] | None = None,
        between: Callable[[WebSocketRoute], None] | None = None,
    ) -> Page:
        """``hold``: requests like this wait in ``page.held``. ``between``: is given every stream the page opens.

        Both are laid before the page opens: laid later, a route may lose what is under way.
        """
        context = browser.new_context(viewport={"width": width, "height": height}, accept_downloads=True)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(300_000)

        def note(message: object) -> None:
            failed = "Failed to load resource" in str(message) or "WebSocket connection" in str(message)
            if not (expect_failures and failed) and DRIVER not in str(message):
                problems.append(str(message))

        page.on("console", lambda m: note(m.text) if m.type in ("error", "warning") else None)
        page.on("pageerror", note)
        page.on("request", lambda r: None if is_here(r.url, url) else problems.append(f"asked {r.url}"))
        page.on("websocket", lambda w: None if is_here(w.url, url) else problems.append(f"asked {w.url}"))
        page.held = []
        if hold is not None:
            page.route(hold, lambda route: page.held.append(route))  # Playwright takes no method of a list
        if between is not None:
            page.route_web_socket("**/stream*", between)
        page.goto(url)
        return page

    yield make
    for context in contexts:
        context.close()
    assert not problems


def is_here(asked: str, url: str) -> bool:
    return urlsplit(asked).scheme in ("blob", "data") or urlsplit(asked).netloc == urlsplit(url).netloc
