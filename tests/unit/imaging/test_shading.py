"""Light and shade: a ball lit from aside tells its own normals from others with the same outline."""

import numpy as np
import pytest

from service.imaging.shading import cut_patch, explained

SIZE, CENTRE, RADIUS = 96, (50.0, 44.0), 26.0


def ball(size: int, centre: tuple[float, float], radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Normals (S, S, 3) towards the camera and coverage of a ball."""
    y, x = np.mgrid[0:size, 0:size] + 0.5
    across = np.stack([x - centre[0], y - centre[1]], axis=-1) / radius
    inside = np.sum(across**2, axis=-1) < 1
    depth = -np.sqrt(np.maximum(0.0, 1 - np.sum(across**2, axis=-1)))
    normals = np.where(inside[..., None], np.concatenate([across, depth[..., None]], axis=-1), 0.0)
    return normals.astype(np.float32), inside.astype(np.float32)


def lit(sun, *, gain: float = 40.0, even: float = 1.0, seed: int = 1) -> np.ndarray:
    """Brightness of the ball under a sun, in units of the noise."""
    normals, covered = ball(SIZE, CENTRE, RADIUS)
    direction = np.asarray(sun, float) / np.linalg.norm(sun)
    noise = np.random.default_rng(seed).standard_normal((SIZE, SIZE))
    return (gain * np.maximum(normals @ direction, 0) + even * covered + noise).astype(np.float32)


def patch_of(brightness: np.ndarray):
    patch = cut_patch(brightness, np.where(brightness > 5, 3.0, -0.5).astype(np.float32), 0.6)
    assert patch is not None
    return patch


def drawn(patch, radius: float = RADIUS, shift: float = 0.0):
    """The ball as the patch sees it."""
    centre = (np.add(CENTRE, (shift, 0.0)) - patch.origin) * patch.zoom
    return ball(len(patch.brightness), tuple(centre), radius * patch.zoom)


@pytest.mark.parametrize("sun", [(0, 0, -1), (1, 0, -0.2), (-0.6, 0.8, -0.1), (0.1, -0.9, -0.5), (0.7, 0.7, 0.3)])
def test_the_right_normals_explain_more_than_a_flat_face_with_the_same_outline(sun):
    patch = patch_of(lit(sun))
    normals, covered = drawn(patch)
    flat = np.where(covered[..., None] > 0, np.float32([0, 0, -1]), np.float32(0))
    assert explained(patch, normals, covered) > explained(patch, flat, covered) + 0.3


def test_a_body_that_is_dark_on_one_side_beats_a_small_one_on_the_lit_side():
    patch = patch_of(lit((1, 0, -0.1)))
    whole = explained(patch, *drawn(patch))
    small = max(explained(patch, *drawn(patch, 0.5 * RADIUS, shift)) for shift in (6.0, 10.0, 14.0))
    assert whole > small + 0.5


def test_the_brightness_scale_does_not_matter():
    bright = lit((1, 0, -0.5))
    patch, twice = patch_of(bright), patch_of(bright)
    twice = type(twice)(4.0 * twice.brightness, twice.light, twice.origin, twice.zoom, twice.blur_px)
    assert explained(twice, *drawn(patch)) == pytest.approx(explained(patch, *drawn(patch)), rel=1e-6)


def test_nothing_there_explains_nothing():
    patch = patch_of(lit((0, 0, -1)))
    nothing = np.zeros_like(patch.brightness)
    assert explained(patch, np.zeros((*nothing.shape, 3), np.float32), nothing) == pytest.approx(0.0, abs=1e-6)


def test_a_pixel_of_the_patch_lies_where_its_origin_and_zoom_say():
    brightness = np.zeros((200, 240), np.float32)
    brightness[60:140, 90:190] = 50.0
    patch = cut_patch(brightness, np.where(brightness > 0, 3.0, -0.5).astype(np.float32), 1.0)
    assert patch is not None and patch.zoom < 1 and len(patch.brightness) <= 65
    y, x = np.nonzero(patch.light)
    low, high = (np.array([f(x), f(y)]) for f in (np.min, np.max))
    assert patch.origin + low / patch.zoom == pytest.approx([90, 60], abs=1.5 / patch.zoom)
    assert patch.origin + (high + 1) / patch.zoom == pytest.approx([190, 140], abs=1.5 / patch.zoom)


def test_without_light_there_is_no_patch():
    empty = np.full((64, 64), -0.5, np.float32)
    assert cut_patch(np.zeros((64, 64), np.float32), empty, 1.0) is None
    empty[5, 5] = empty[40, 9] = 3.0  # specks
    assert cut_patch(np.zeros((64, 64), np.float32), empty, 1.0) is None
