"""The point spread, from the edges of blurred shapes."""

import cv2
import numpy as np
import pytest

from service.imaging.psf import estimate_psf_sigma


def shape(kind: str, size: int = 128, over: int = 8) -> np.ndarray:
    """(H, W) share of each pixel that a disc or a turned square covers."""
    g = (np.arange(size * over) + 0.5) / over - size / 2 - 0.3
    x, y = g[None] * np.cos(0.35) + g[:, None] * np.sin(0.35), g[:, None] * np.cos(0.35) - g[None] * np.sin(0.35)
    inside = np.hypot(x, y) < 30 if kind == "disc" else np.maximum(np.abs(x), np.abs(y)) < 28
    return inside.reshape(size, over, size, over).mean((1, 3)).astype(np.float32)


@pytest.mark.parametrize("kind", ["disc", "square"])
@pytest.mark.parametrize("sigma", [0.7, 1.0, 1.5, 2.0, 3.0])
@pytest.mark.parametrize("height", [60, 200, 1500])
def test_within_a_quarter_of_the_truth(kind, sigma, height):
    """Heights are in units of the noise, as the contrast is."""
    noise = np.random.default_rng(4).standard_normal((128, 128))
    contrast = np.abs(height * cv2.GaussianBlur(shape(kind), (0, 0), sigma) + noise).astype(np.float32)
    assert estimate_psf_sigma(contrast) == pytest.approx(sigma, rel=0.25)


def test_wider_is_seen_as_wider():
    clean = [200 * cv2.GaussianBlur(shape("disc"), (0, 0), sigma) for sigma in (0.7, 1.0, 1.5, 2.0, 3.0)]
    found = [estimate_psf_sigma(contrast) for contrast in clean]
    assert np.all(np.diff(found) > 0.1)


def test_shading_within_the_object_is_no_edge_to_the_sky():
    """Soft steps between bright panels are many here, and 4 px wide; the outline is 1 px."""
    x = np.arange(128)
    panels = (150 + 60 * np.sin(x / 4.0)).astype(np.float32)[None] * np.ones((128, 1), np.float32)
    contrast = cv2.GaussianBlur(shape("square") * panels, (0, 0), 1.0)
    assert estimate_psf_sigma(contrast) == pytest.approx(1.0, rel=0.25)


def test_an_empty_sky_tells_nothing():
    noise = np.abs(np.random.default_rng(5).standard_normal((64, 64))).astype(np.float32)
    assert estimate_psf_sigma(noise) is None
    assert estimate_psf_sigma(np.zeros((64, 64), np.float32)) is None
