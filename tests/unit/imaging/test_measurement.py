"""Equations 1 to 3 by hand."""

import numpy as np
import pytest

from service.imaging.background import FLOOR, learn
from service.imaging.features import feature_spec
from service.imaging.measurement import measure
from service.imaging.sky import Sky, derive


def sky_of(frames, *, bits: int = 8, feature: str = "auto") -> Sky:
    background = None
    for frame in frames:
        spec = feature_spec(feature, 1 if frame.ndim == 2 else 3, bits, 1.0)
        background = learn(background, frame, bits, spec, np.ones(frame.shape[:2], bool))
    assert background is not None
    return derive(background, feature, 1.0)


def test_equations_2_and_3_by_hand():
    """Two bits: background 6 zeros and 2 ones, so p(D|b) = 0.7495, 0.25, 0.00025, 0.00025; p(D|f) = 1/4.

    log c is log(0.25 / 0.7495), 0 and log 1000 for levels 0, 1 and 3; the frame's p(D) is 2/6, 1/6, 3/6.
    """
    sky = sky_of([np.array([[0, 0, 0, 1], [0, 0, 1, 0]], np.uint8)], bits=2)
    image = np.array([[0, 3, 3], [0, 3, 1]], np.uint8)
    log_ratio, log_background = measure(image, sky)
    zero = -1.0980
    np.testing.assert_allclose(log_ratio, [[zero, 6.9078, 6.9078], [zero, 6.9078, 0]], atol=1e-4)
    constant = 2 * np.log(0.7495 / (2 / 6)) + np.log(0.25 / (1 / 6)) + 3 * np.log(0.00025 / (3 / 6))
    assert log_background == pytest.approx(constant, abs=1e-9)
    assert log_background == pytest.approx(1.62053 + 0.40547 - 22.80271, abs=1e-4)


@pytest.mark.parametrize("feature", ["intensity", "colour", "gradient"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_every_feature_has_an_even_foreground_and_a_floored_background(feature, dtype):
    """log c = -log(bins) - log p(D|b), bounded by the floor: a colour never seen in the sky is worth -log(FLOOR)."""
    bits = np.dtype(dtype).itemsize * 8
    rng = np.random.default_rng(1)
    top = np.iinfo(dtype).max
    frames = [rng.integers(0, top // 4, (24, 24, 3)).astype(dtype) for _ in range(3)]
    sky = sky_of(frames, bits=bits, feature=feature)
    image = frames[0].copy()
    image[8:16, 8:16] = top
    log_ratio, log_background = measure(image, sky)
    assert log_ratio.dtype == np.float32
    assert log_ratio.max() == pytest.approx(-np.log(FLOOR), rel=1e-5)
    assert np.isfinite(log_background)
