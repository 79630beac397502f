"""How bright the empty sky is where a body hides it."""

from dataclasses import replace

import numpy as np
import pytest
from test_patch import SHAPE, light, noise, sky

from service.imaging.patch import cut, light_of


def test_a_patch_knows_how_bright_the_empty_sky_is_at_its_places():
    slope = np.broadcast_to(np.linspace(80, 120, SHAPE[1], dtype=np.float32)[None, :, None], (*SHAPE, 1)).copy()
    slope[30, 40] = 900.0  # a hot pixel, or a star
    image = np.round(slope[..., 0] + 5 * noise()).astype(np.uint16)
    found = light_of(image, replace(sky([5.0]), mean=slope), 16)
    assert found.sky == pytest.approx(100.0, abs=1.0) and found.uneven[30, 40] == 2.0
    assert found.uneven[60] == pytest.approx(slope[60, :, 0] / found.sky)
    part = light_of(image, replace(sky([5.0]), mean=slope), 16, (slice(20, 120), slice(0, 160)))
    assert part.uneven[40] * part.sky == pytest.approx(slope[60, :, 0])
    patch = cut(found, (80.0, 60.0), 90.0, 45.0)
    x = patch.origin[0] + patch.binning * (np.arange(patch.side) + 0.5)
    inside = (x > 2) & (x < SHAPE[1] - 2)
    assert patch.uneven[patch.side // 2][inside] * patch.sky == pytest.approx(
        np.interp(x, np.arange(160) + 0.5, slope[0, :, 0])[inside], rel=0.01
    )
    assert cut(light(image), (80.0, 60.0), 90.0, 45.0).uneven is None
    assert light_of(image, sky([5.0], 0.0), 16).uneven is None  # no sky, nothing of it to hide
