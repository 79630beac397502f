"""The direct alignment of frame and model, on a lit ball whose motion is known by hand."""

import numpy as np
import pytest

from service.imaging.lighting import BLOCK_PX, View, align, dispersion
from service.imaging.shading import Patch
from tests.unit.imaging.test_shading import ball, lit, patch_of

SIZE, CENTRE, RADIUS = 96, (50.0, 44.0), 26.0


def view_of(patch: Patch, shift: tuple[float, float] = (0.0, 0.0), surfaces: int = 1) -> View:
    """The ball with two coordinates, x and y in px of the image, and as many surfaces beside each other."""
    centre = (np.add(CENTRE, shift) - patch.origin) * patch.zoom
    side = len(patch.brightness)
    normals, covered = ball(side, tuple(centre), RADIUS * patch.zoom)
    pixel = np.flatnonzero(covered)
    normal = normals.reshape(-1, 3)[pixel].astype(np.float64)
    flow = np.zeros((2, len(pixel), 2))
    flow[0, :, 0] = flow[1, :, 1] = patch.zoom
    return View(pixel, normal, normal[:, 2], pixel % side * surfaces // side, flow, np.zeros((2, len(pixel), 3)))


@pytest.mark.parametrize("shift", [(0.7, 0.0), (0.0, -0.7), (-0.5, 0.5)])
def test_a_step_leads_back_to_where_the_ball_is(shift):
    patch = patch_of(lit((1, 0.3, -0.4)))
    for _ in range(2):
        found = align(patch, view_of(patch, tuple(shift)))
        shift = np.add(shift, np.linalg.solve(found.curvature, found.gradient))
    assert shift == pytest.approx([0.0, 0.0], abs=0.25)


def test_where_the_ball_is_the_gradient_is_small_beside_the_curvature():
    patch = patch_of(lit((1, 0.3, -0.4)))
    found = align(patch, view_of(patch))
    assert np.abs(np.linalg.solve(found.curvature, found.gradient)).max() < 0.15
    assert np.linalg.eigvalsh(found.curvature).min() > 0


def test_the_scale_of_the_brightness_does_not_matter():
    patch = patch_of(lit((1, 0.3, -0.4)))
    twice = Patch(4.0 * patch.brightness, patch.light, patch.origin, patch.zoom, patch.blur_px)
    one, other = align(patch, view_of(patch)), align(twice, view_of(patch))
    assert other.curvature == pytest.approx(one.curvature, rel=0.02, abs=0.01 * np.trace(one.curvature))


def test_a_surface_painted_otherwise_hardly_moves_the_answer():
    picture = lit((0.3, 0.2, -1))
    picture[:, : int(CENTRE[0])] *= 1.6
    patch = patch_of(picture)
    free, alike = (align(patch, view_of(patch, surfaces=n)) for n in (2, 1))
    step, pulled = (np.linalg.solve(found.curvature, found.gradient) for found in (free, alike))
    assert np.abs(step).max() < 0.25 < np.abs(pulled).max()


def test_residuals_that_belong_together_count_once():
    """Of residuals that are the same within each square, a square counts as one pixel does of independent ones."""
    rng = np.random.default_rng(3)
    side = 10 * BLOCK_PX
    patch = Patch(np.zeros((side, side), np.float32), np.zeros((side, side), bool), np.zeros(2), 1.0, 0.1)
    pixels, slopes = np.arange(side * side), rng.standard_normal((side * side, 3)).astype(np.float32)
    alone = rng.standard_normal((side * side, 1)).astype(np.float32)
    square = pixels // side // BLOCK_PX * 10 + pixels % side // BLOCK_PX
    together = rng.standard_normal((100, 1)).astype(np.float32)[square]
    slope = np.ones((side * side, 3), np.float32) + 0.1 * slopes
    curvature = (slope.T @ slope).astype(np.float64)
    assert dispersion(slope * alone, curvature, pixels, patch) < 6.0
    many = dispersion(slope * together, curvature, pixels, patch)
    assert BLOCK_PX**2 / 9 < many < BLOCK_PX**2  # one of the three directions feels the common part
