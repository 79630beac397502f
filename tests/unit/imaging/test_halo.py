"""The veil of scattered light: found where it is, not taken from dim parts, absent where there is none."""

import cv2
import numpy as np
import pytest

from service.imaging.background import Background, Sky, derive, known_pixels, learn
from service.imaging.features import feature_spec
from service.imaging.halo import veil
from service.imaging.measurement import measure, sky_residual

SIDE, SKY, NOISE = 160, 300.0, 8.0
SHARE = 0.08  # of the light, that is scattered


@pytest.fixture(scope="module")
def sky() -> Sky:
    rng = np.random.default_rng(1)
    background: Background | None = None
    for _ in range(10):
        empty = (SKY + NOISE * rng.standard_normal((SIDE, SIDE))).astype(np.uint16)
        background = learn(
            background, empty, 16, feature_spec("auto", 1, 16, 1.0), known_pixels(SIDE, SIDE, None, None)
        )
    return derive(background, "auto", 1.0)


def scene(dim: float, scattered: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The frame, the bright body, a dim panel beside it, and the veil."""
    body, panel = (np.zeros((SIDE, SIDE), np.float32) for _ in range(2))
    body[60:100, 50:90] = 1.0
    panel[70:90, 96:130] = 1.0
    light = cv2.GaussianBlur(2000.0 * body + dim * panel, (0, 0), 1.2)
    wings = SHARE * cv2.GaussianBlur(light, (0, 0), 7.0) if scattered else np.zeros_like(light)
    noise = NOISE * np.random.default_rng(2).standard_normal((SIDE, SIDE))
    return (SKY + light + wings + noise).astype(np.uint16), body > 0, panel > 0, wings


def near(body: np.ndarray) -> np.ndarray:
    return cv2.dilate(body.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0


def test_the_veil_is_found(sky):
    image, body, _, wings = scene(0.0, True)
    found = veil(sky_residual(image, sky), sky, body, near(body), 1.2)[..., 0]
    around = ~near(body) & (wings > 0.2 * wings[~near(body)].max())
    assert wings[around].mean() > 2 * NOISE  # without it this is light, and plenty
    assert abs(found[around] - wings[around]).mean() < 0.15 * wings[around].mean()


def test_where_nothing_is_scattered_nothing_is_found(sky):
    image, body, _, _ = scene(0.0, False)
    found = veil(sky_residual(image, sky), sky, body, near(body), 1.2)[..., 0]
    assert found[~near(body)].max() < 0.5 * NOISE


def test_a_dim_panel_is_no_veil(sky):
    """It stands on one side; the veil is fitted to the sky on all the others."""
    image, body, panel, _ = scene(5 * NOISE, False)
    found = veil(sky_residual(image, sky), sky, body, near(body), 1.2)[..., 0]
    assert found[panel & ~near(body)].mean() < 0.15 * 5 * NOISE


def test_no_veil_is_brighter_than_its_light(sky):
    """One speck on a large dim surface: what surrounds it is not scattered out of it."""
    surface = cv2.GaussianBlur(np.pad(np.full((80, 80), 3 * NOISE, np.float32), 40), (0, 0), 1.2)
    noise = NOISE * np.random.default_rng(3).standard_normal((SIDE, SIDE))
    residual = sky_residual((SKY + surface + noise).astype(np.uint16), sky)
    speck = np.zeros((SIDE, SIDE), bool)
    speck[79:81, 79:81] = True
    found = veil(residual, sky, speck, near(speck), 1.2)
    assert found.sum() <= 0.75 * residual[speck].sum()


def test_the_veil_is_not_evidence_and_the_panel_is(sky):
    """Light around the body would hold a silhouette that is too large; the panel must go on to count."""
    image, body, panel, _ = scene(4 * NOISE, True)
    maps = measure(image, sky, kind="contrast", psf_sigma_px=1.2, covered_empty_nats=1.0, uncovered_bright_nats=3.0)
    ring = cv2.dilate(body.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (41, 41))) > 0
    ring &= ~near(body) & ~cv2.dilate(panel.astype(np.uint8), np.ones((11, 11), np.uint8)).astype(bool)
    inner = cv2.erode(panel.astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    assert (maps.log_ratio[ring] > 0).mean() < 0.1
    assert (maps.log_ratio[inner] > 0).mean() > 0.8
