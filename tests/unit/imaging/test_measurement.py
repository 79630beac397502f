"""Equations 1 to 3 by hand, and the contrast map's edge against the true one."""

import cv2
import numpy as np
import pytest
from scipy import ndimage

from service.imaging.background import FLOOR, Sky, derive, learn
from service.imaging.features import feature_spec
from service.imaging.measurement import FrameMaps, even_edge, histogram_log_ratio, measure

SIZE = 96
CENTRE = (48.3, 47.6)
RADIUS = 18.0


def sky_of(frames, *, bits: int = 8, feature: str = "auto") -> Sky:
    background = None
    for frame in frames:
        spec = feature_spec(feature, 1 if frame.ndim == 2 else 3, bits, 1.0)
        background = learn(background, frame, bits, spec, np.ones(frame.shape[:2], bool))
    assert background is not None
    return derive(background, feature, 1.0)


def maps(
    image, sky: Sky, kind: str = "contrast", psf_sigma_px: float | None = None, rise: float | None = None
) -> FrameMaps:
    return measure(
        image,
        sky,
        kind=kind,
        psf_sigma_px=psf_sigma_px,
        covered_empty_nats=1.0,
        uncovered_bright_nats=3.0,
        edge_nats_per_px=rise,
    )


def disc(radius: float = RADIUS, size: int = SIZE, over: int = 8) -> np.ndarray:
    g = (np.arange(size * over) + 0.5) / over
    inside = np.hypot(g[None] - CENTRE[0], g[:, None] - CENTRE[1]) < radius
    return inside.reshape(size, over, size, over).mean((1, 3)).astype(np.float32)


def frame(light: np.ndarray | float, seed: int, *, dtype=np.uint8, gain: float = 1.0, noise: float = 2.0) -> np.ndarray:
    """A frame of a sky of level 20 with ``light`` on it."""
    rng = np.random.default_rng(seed)
    shape = (SIZE, SIZE) if np.ndim(light) == 0 else np.shape(light)
    counts = gain * (20 + light + noise * rng.standard_normal(shape))
    return np.clip(np.rint(counts), 0, np.iinfo(dtype).max).astype(dtype)


def test_equations_2_and_3_by_hand():
    """Two bits: background 6 zeros and 2 ones, so p(D|b) = 0.7495, 0.25, 0.00025, 0.00025; p(D|f) = 1/4.

    log c is log(0.25 / 0.7495), 0 and log 1000 for levels 0, 1 and 3; the frame's p(D) is 2/6, 1/6, 3/6.
    """
    sky = sky_of([np.array([[0, 0, 0, 1], [0, 0, 1, 0]], np.uint8)], bits=2)
    image = np.array([[0, 3, 3], [0, 3, 1]], np.uint8)
    found = maps(image, sky, "histogram")
    zero = -1.0980
    np.testing.assert_allclose(found.log_ratio, [[zero, 6.9078, 6.9078], [zero, 6.9078, 0]], atol=1e-4)
    constant = 2 * np.log(0.7495 / (2 / 6)) + np.log(0.25 / (1 / 6)) + 3 * np.log(0.00025 / (3 / 6))
    assert found.log_background == pytest.approx(constant, abs=1e-9)
    assert found.log_background == pytest.approx(1.62053 + 0.40547 - 22.80271, abs=1e-4)


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
    found = maps(image, sky, "histogram")
    assert found.log_ratio.dtype == np.float32
    assert found.log_ratio.max() == pytest.approx(-np.log(FLOOR), rel=1e-5)
    assert np.isfinite(found.log_background)
    assert histogram_log_ratio(np.array([[0]]), sky)[0, 0] == pytest.approx(
        -np.log(sky.spec.n_bins) - sky.log_density[0], rel=1e-6
    )


def edge_radii(log_ratio: np.ndarray, radius: float) -> np.ndarray:
    """(72,) distances from the centre at which the map changes sign for good, within 4 px of the true edge."""
    angle = np.linspace(0, 2 * np.pi, 72, endpoint=False)[:, None]
    r = np.arange(radius - 4, radius + 4, 0.02)
    x, y = CENTRE[0] + r * np.cos(angle) - 0.5, CENTRE[1] + r * np.sin(angle) - 0.5
    along = ndimage.map_coordinates(log_ratio, [y, x], order=1)
    assert np.all(along[:, 0] > 0)  # inside
    return r[np.argmax(along <= 0, axis=1)]


@pytest.mark.parametrize("sigma", [0.7, 1.0, 1.5, 2.0, 3.0])
@pytest.mark.parametrize("given", [True, False])
@pytest.mark.parametrize(("height", "noise"), [(60, 2.0), (200, 5.0)])
def test_a_blur_does_not_move_the_edge(sigma, given, height, noise):
    """The map's sign changes at the true outline, whatever the blur, known or estimated: fact 4."""
    sky = sky_of([frame(0.0, seed, noise=noise) for seed in range(10)])
    image = frame(height * cv2.GaussianBlur(disc(), (0, 0), sigma), 99, noise=noise)
    found = maps(image, sky, psf_sigma_px=sigma if given else None)
    off = edge_radii(found.log_ratio, RADIUS) - RADIUS
    assert abs(np.mean(off)) < 0.3
    assert np.percentile(np.abs(off), 90) < 0.6  # single directions carry the noise
    if not given:
        assert found.psf_sigma_px == pytest.approx(sigma, rel=0.25)


def test_the_histogram_map_does_move_it():
    """The reason for the contrast map: the paper's map calls the light that a blur carries out object."""
    sky = sky_of([frame(0.0, seed) for seed in range(10)])
    image = frame(200 * cv2.GaussianBlur(disc(), (0, 0), 2.0), 99)
    outside = (disc(RADIUS + 3) == 1) & (disc(RADIUS + 1) == 0)
    assert maps(image, sky, "histogram").log_ratio[outside].mean() > 3
    assert maps(image, sky).log_ratio[outside].mean() < -0.5


@pytest.mark.parametrize(("dtype", "bits", "gain"), [(np.uint8, 8, 1.0), (np.uint16, 16, 100.0)])
def test_the_contrast_map_is_bounded_and_reads_light_from_sky(dtype, bits, gain):
    sky = sky_of([frame(0.0, seed, dtype=dtype, gain=gain) for seed in range(10)], bits=bits)
    image = frame(100 * cv2.GaussianBlur(disc(), (0, 0), 1.0), 99, dtype=dtype, gain=gain)
    log_ratio = maps(image, sky).log_ratio
    assert log_ratio.dtype == np.float32
    assert log_ratio.min() == -1.0
    assert log_ratio.max() == 3.0
    assert np.all(log_ratio[disc(RADIUS - 2) == 1] > 0)
    assert np.mean(log_ratio[disc(RADIUS + 8) == 0] > 0) < 0.01


def test_the_colour_of_light_does_not_matter_to_the_contrast_map():
    """A red and a blue half against a grey sky: both are light."""
    light = 100 * cv2.GaussianBlur(disc(), (0, 0), 1.0)
    colours = np.zeros((SIZE, SIZE, 3), np.float32)
    colours[:, :48, 0], colours[:, 48:, 2] = light[:, :48], light[:, 48:]
    sky = sky_of([frame(np.zeros((SIZE, SIZE, 3)), seed) for seed in range(10)])
    found = maps(frame(colours, 99), sky)
    off = edge_radii(found.log_ratio, RADIUS) - RADIUS
    assert abs(np.mean(off)) < 0.3
    assert np.all(found.log_ratio[disc(RADIUS - 2) == 1] > 0)


def test_an_empty_frame_has_next_to_no_light():
    sky = sky_of([frame(0.0, seed) for seed in range(10)])
    assert np.mean(maps(frame(0.0, 99), sky).log_ratio > 0) < 0.005


def test_a_change_of_the_skys_level_is_no_light():
    sky = sky_of([frame(0.0, seed) for seed in range(10)])
    brighter = frame(30.0, 99)
    assert np.mean(maps(brighter, sky).log_ratio > 0) < 0.005


def test_a_change_of_the_skys_gradient_is_no_light():
    """A moonrise: ten sigma more in one corner than in the other, with the object in the frame."""
    sky = sky_of([frame(0.0, seed) for seed in range(10)])
    across = np.linspace(-7, 7, SIZE)
    image = frame(np.float32(20 + across + across[:, None]) + 80 * disc(), 99)
    level = frame(np.float32(20) + 80 * disc(), 99)
    found, expected = (maps(one, sky, psf_sigma_px=1.0).log_ratio > 0 for one in (image, level))
    assert np.mean(found & ~expected) < 0.005
    assert np.mean(found & (disc() > 0.5)) > 0.99 * np.mean(disc())


@pytest.mark.parametrize("radius", [22.0, 34.0])
@pytest.mark.parametrize("sigma", [1.0, 2.0, 3.0])
def test_a_large_object_does_not_make_light_of_the_sky(radius, sigma):
    sky = sky_of([frame(0.0, seed) for seed in range(10)])
    image = frame(120 * cv2.GaussianBlur(disc(radius), (0, 0), sigma), 99)
    log_ratio = maps(image, sky, psf_sigma_px=sigma).log_ratio
    assert np.mean(log_ratio[disc(radius + 4 * sigma + 2) == 0] > 0) < 0.02


@pytest.mark.parametrize("rise", [None, 0.6])
@pytest.mark.parametrize("height", [8.0, 8.8, 9.6, 10.4])
def test_a_dim_surface_is_whole(height, rise):
    """Two to two and a half times a pixel's noise: specks by themselves, a disc by neighbourhoods, always.

    Nor are the specks that do stand out taken for lights whose veil the rest would be.
    """
    sky = sky_of([frame(0.0, seed, noise=4.0) for seed in range(10)])
    found = maps(frame(height * disc(), 99, noise=4.0), sky, rise=rise).log_ratio
    assert np.mean(found[disc(RADIUS - 4) == 1] > 0) > 0.95
    assert np.mean(found[disc(RADIUS + 4) == 0] > 0) < 0.02


def test_the_edge_costs_alike_on_both_sides():
    """The first pixel of light costs as much as the first of dark, each further one 1.3 nats more; dark stays."""
    log_ratio = np.full((9, 9), -0.5, np.float32)
    log_ratio[:, 4:] = 3.0
    row = even_edge(log_ratio, 0.5, 1.3)[4]
    np.testing.assert_allclose(row[:4], -0.5)
    assert 0.5 <= row[4] <= 0.5 + 1.3
    assert np.all(np.diff(row[4:7]) > 0)
    assert row[8] == 3.0


def test_uneven_prices_make_the_best_disc_too_large_and_even_ones_do_not():
    """Ragged light: the edge scatters by a pixel or two. The radius of highest sum is that of the middle edge."""
    rng = np.random.default_rng(2)
    g = np.arange(160) + 0.5 - 80
    radius, angle = np.hypot(g, g[:, None]), np.arctan2(g[:, None], g)
    ragged = 40 + 1.5 * np.interp(angle, np.linspace(-np.pi, np.pi, 90), rng.standard_normal(90))
    log_ratio = np.where(radius < ragged, 3.0, -0.5).astype(np.float32)
    radii = np.arange(36, 45, 0.05)

    def best(values: np.ndarray) -> float:
        return float(radii[np.argmax([values[radius < r].sum() for r in radii])])

    assert best(log_ratio) > 41.0
    assert abs(best(even_edge(log_ratio, 0.5, 1.3)) - 40) < 0.7 * (best(log_ratio) - 40)
