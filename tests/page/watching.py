"""What a user sees on the page, as words of the tests."""

import re
from pathlib import Path

import cv2
import httpx
import numpy as np
from playwright.sync_api import Page, expect


def shows(page: Page, index: int) -> None:
    """Wait until the page shows this frame."""
    expect(page.locator("html")).to_have_attribute("data-shown", str(index))


def shown(page: Page) -> int:
    """The frame that is shown; -1 before the first."""
    return int(page.locator("html").get_attribute("data-shown") or -1)


def picture_shows(page: Page, index: int) -> None:
    """Wait until image and outlines are those of this frame."""
    expect(page.locator("#frame .frame-number")).to_have_text(str(index))


def open_session(page: Page, session_id: str) -> None:
    """Choose a session in the list."""
    page.locator(f'[data-session="{session_id}"]').click()
    expect(page.locator(f'[data-session="{session_id}"]')).to_have_attribute("aria-current", "true")


def drop(page: Page, path: Path) -> None:
    """A real drop of a file or folder on the page."""
    session = page.context.new_cdp_session(page)
    data = {"items": [], "files": [str(path)], "dragOperationsMask": 1}
    for kind in ("dragEnter", "dragOver", "dragOver", "drop"):
        session.send("Input.dispatchDragEvent", {"type": kind, "x": 600, "y": 400, "data": data})
        if kind == "dragOver":
            expect(page.locator("body")).to_have_class("dropping")  # what is under the pointer takes files


def is_stale(page: Page) -> None:
    """Wait for the mark over everything."""
    expect(page.locator("#stale")).to_have_text(re.compile("^Stale: .* Nothing heard"))
    expect(page.locator("#link .text")).to_have_text("reconnecting")


def is_live(page: Page) -> None:
    """Wait until the mark is gone."""
    expect(page.locator("#stale")).to_be_hidden()
    expect(page.locator("#link")).to_have_class("live")


def stage(page: Page, figure: str = "#frame") -> np.ndarray:
    """(H, W, 3) what a view shows on the screen, BGR."""
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    data = page.locator(f"{figure} .stage").first.screenshot()
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR).astype(np.int16)


def silhouette_on_screen(page: Page) -> np.ndarray:
    """(H, W) bool: what the outlines change on the frame's view."""
    with_outline = stage(page)
    page.keyboard.press("o")
    without = stage(page)
    page.keyboard.press("o")
    return np.abs(with_outline - without).max(axis=2) > 8


def silhouette_of_service(url: str, index: int, shape: tuple[int, int]) -> np.ndarray:
    """(H, W) bool: the silhouette that the service draws, on a view of this shape."""
    pictures = [httpx.get(f"{url}/estimates/{index}/{name}.png").content for name in ("overlay", "frame")]
    overlay, frame = (cv2.imdecode(np.frombuffer(p, np.uint8), cv2.IMREAD_COLOR).astype(np.int16) for p in pictures)
    mask = (np.abs(overlay - frame).max(axis=2) > 8).astype(np.uint8)
    height, width = shape
    side = min(width / mask.shape[1], height / mask.shape[0])
    move = np.array([[side, 0, (width - side * mask.shape[1]) / 2], [0, side, (height - side * mask.shape[0]) / 2]])
    return cv2.warpAffine(mask, move, (width, height), flags=cv2.INTER_NEAREST) > 0


def agree(seen: np.ndarray, expected: np.ndarray, width_px: int = 4) -> float:
    """The smaller of two shares: of ``expected`` that is seen, and of what is seen within ``width_px`` of it."""
    near = cv2.dilate(expected.astype(np.uint8), np.ones((2 * width_px + 1,) * 2, np.uint8)) > 0
    return min(float((seen & expected).sum() / expected.sum()), float((seen & near).sum() / max(seen.sum(), 1)))
