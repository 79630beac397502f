"""The sky: learned from frames, told apart from stars, stored and read back."""

import dataclasses
import io

import cv2
import numpy as np
import pytest

from service.imaging.background import FLOOR, KEPT_FRAMES, Background, known_pixels, learn
from service.imaging.features import feature_spec
from service.imaging.sky import Sky, derive

HEIGHT, WIDTH = 60, 80


def learned(frames, *, bits: int = 8, feature: str = "auto", known=None) -> Background:
    background = None
    for frame in frames:
        channels = 1 if frame.ndim == 2 else frame.shape[2]
        everywhere = np.ones(frame.shape[:2], bool) if known is None else known
        background = learn(background, frame, bits, feature_spec(feature, channels, bits, 1.0), everywhere)
    assert background is not None
    return background


def sky_of(frames, *, bits: int = 8, feature: str = "auto", known=None) -> Sky:
    return derive(learned(frames, bits=bits, feature=feature, known=known), feature, 1.0)


def noisy(level, sigma: float, count: int, dtype=np.uint8, seed: int = 1) -> list[np.ndarray]:
    """Frames of a level (scalar or (H, W[, C])) with Gaussian noise."""
    rng = np.random.default_rng(seed)
    shape = (HEIGHT, WIDTH) if np.ndim(level) == 0 else np.shape(level)
    top = np.iinfo(dtype).max
    return [np.clip(np.rint(level + sigma * rng.standard_normal(shape)), 0, top).astype(dtype) for _ in range(count)]


def test_the_histogram_by_hand():
    """Two-bit frames: 6 and 5 zeros, 2 and 3 ones of 8 pixels each, so 11/16, 5/16, and a floor of FLOOR / 4."""
    first = np.array([[0, 0, 0, 1], [0, 0, 1, 0]], np.uint8)
    second = np.array([[1, 0, 0, 1], [0, 0, 1, 0]], np.uint8)
    sky = sky_of([first, second], bits=2)
    expected = (1 - FLOOR) * np.array([11 / 16, 5 / 16, 0, 0]) + FLOOR / 4
    np.testing.assert_allclose(np.exp(sky.log_density), expected, rtol=1e-12)
    assert np.exp(sky.log_density).sum() == pytest.approx(1)


def test_the_histogram_counts_every_frame_but_only_the_last_are_kept():
    background = learned(noisy(20.0, 2.0, KEPT_FRAMES + 5))
    assert background.n_frames == KEPT_FRAMES + 5
    assert len(background.frames) == KEPT_FRAMES
    assert background.counts.sum() == (KEPT_FRAMES + 5) * HEIGHT * WIDTH
    np.testing.assert_array_equal(background.frames[-1, ..., 0], noisy(20.0, 2.0, KEPT_FRAMES + 5)[-1])


@pytest.mark.parametrize(
    ("shape", "dtype", "bits"), [((9, 7), np.uint8, 8), ((9, 7), np.uint16, 16), ((9, 7, 3), np.uint8, 8)]
)
def test_a_blob_comes_back_bit_for_bit(shape, dtype, bits):
    rng = np.random.default_rng(2)
    frames = [rng.integers(0, np.iinfo(dtype).max, shape).astype(dtype) for _ in range(3)]
    background = learned(frames, bits=bits, known=rng.random(shape[:2]) < 0.7)
    blob = background.to_bytes()
    back = Background.from_bytes(blob)
    for field in dataclasses.fields(Background):
        before, after = getattr(background, field.name), getattr(back, field.name)
        np.testing.assert_array_equal(after, before)
        assert np.asarray(after).dtype == np.asarray(before).dtype
    assert back.to_bytes() == blob
    assert back.shape == (9, 7, 3 if len(shape) == 3 else 1)


def test_a_blob_does_not_depend_on_when_it_is_made(monkeypatch):
    background = learned(noisy(20.0, 2.0, 2))
    blob = background.to_bytes()
    monkeypatch.setattr("time.time", lambda: 2e9)
    monkeypatch.setattr("time.localtime", lambda *_: (2033, 5, 18, 3, 33, 20, 2, 138, 0))
    assert background.to_bytes() == blob


def test_a_blob_of_another_version_is_refused():
    background = learned(noisy(20.0, 2.0, 1))
    blob = background.to_bytes()
    with np.load(io.BytesIO(blob)) as data:
        arrays = dict(data)
    arrays["meta"][0] = 2
    out = io.BytesIO()
    np.savez(out, **arrays)
    with pytest.raises(ValueError, match="version 2"):
        Background.from_bytes(out.getvalue())


def test_learning_does_not_change_what_was_learned_before():
    frames = noisy(20.0, 2.0, 2)
    first = learned(frames[:1])
    blob = first.to_bytes()
    learn(first, frames[1], 8, feature_spec("auto", 1, 8, 1.0), np.ones((HEIGHT, WIDTH), bool))
    frames[0][:] = 0
    assert first.to_bytes() == blob


@pytest.mark.parametrize(
    ("box", "border", "expected"),
    [
        (None, None, "1111 1111 1111"),
        ((1, 1, 2, 1), None, "1111 1001 1111"),
        ((0.6, -5, 2.0, 6.4), None, "1001 1111 1111"),
        ((-3, -3, 1, 1), None, "1111 1111 1111"),
        ((2, 1, 100, 100), None, "1111 1100 1100"),
        (None, 1, "1111 1001 1111"),
        (None, 0.2, "1111 1001 1111"),
        (None, 2, "1111 1111 1111"),
        ((0, 0, 1, 3), 1, "0111 0001 0111"),
    ],
)
def test_known_pixels(box, border, expected):
    rows = [[digit == "1" for digit in row] for row in expected.split()]
    np.testing.assert_array_equal(known_pixels(3, 4, box, border), rows)


def test_only_known_pixels_count():
    frame = np.full((HEIGHT, WIDTH), 20, np.uint8)
    frame[10:30, 20:50] = 200
    sky = sky_of([frame], known=known_pixels(HEIGHT, WIDTH, (20, 10, 30, 20), None))
    assert sky.log_density[200] == pytest.approx(np.log(FLOOR / 256))
    assert sky.log_density[20] == pytest.approx(np.log(1 - FLOOR + FLOOR / 256))
    assert np.abs(sky.mean - 20).max() < 1  # the object is no sky


@pytest.mark.parametrize("count", [3, 10, KEPT_FRAMES + 4])
def test_a_star_in_one_frame_does_not_survive_in_the_mean(count):
    frames = noisy(20.0, 2.0, count)
    frames[count // 2][30:33, 40:43] = 220
    sky = sky_of(frames)
    assert np.abs(sky.mean[28:35, 38:45] - 20).max() < 5
    assert sky.sigma[0] == pytest.approx(2.0, rel=0.08)


def test_a_star_that_passes_leaves_no_trace():
    """A telescope that follows its object: nothing of the star is there when the object is."""
    frames, (rows, columns) = noisy(20.0, 2.0, 6), np.mgrid[:HEIGHT, :WIDTH]
    for k, frame in enumerate(frames):
        away = (columns - 40) ** 2 + (rows - 25 - 1.5 * k) ** 2
        frame += (90 * np.exp(-0.5 * away / 1.7**2)).astype(np.uint8)
        frame[10, 60] = 90  # a hot pixel stays where it is
    sky = sky_of(frames)
    assert np.abs(sky.mean[20:40, 30:50] - 20).max() < 5
    assert sky.mean[10, 60, 0] == pytest.approx(90, abs=5)


def test_a_star_in_the_only_frame_does_not_survive_either():
    (frame,) = noisy(20.0, 2.0, 1)
    frame[30:32, 40:42] = 220
    assert np.abs(sky_of([frame]).mean - 20).max() < 8


@pytest.mark.parametrize("level", [20.5, 404.5])
@pytest.mark.parametrize("seed", range(4))
def test_a_level_between_whole_counts_is_no_noise(level, seed):
    """The median of such a frame is one whole count or the next."""
    assert sky_of(noisy(level, 4.0, 3, np.uint16, seed), bits=16).sigma == pytest.approx(4.0, rel=0.06)


@pytest.mark.parametrize("count", [1, 3])
def test_a_slope_goes_on_to_the_border(count):
    """It is no noise there, and no light."""
    across, down = np.meshgrid(np.linspace(-1, 1, 200), np.linspace(-1, 1, 160))
    level = 400 + 80 * across - 25 * down + 30 * across * down
    sky = sky_of(noisy(level, 5.0, count, np.uint16), bits=16)
    assert sky.sigma == pytest.approx(5.0, rel=0.06)
    off = sky.mean[..., 0] - level
    assert max(abs(edge.mean()) for edge in (off[0], off[-1], off[:, 0], off[:, -1])) < 0.1 * 5.0


def test_a_large_sky_is_told_from_a_part_of_its_pixels():
    """Level and noise are; what is smooth, and what is hot, is told of every pixel."""
    across, down = np.meshgrid(np.linspace(-1, 1, 1300, dtype=np.float32), np.linspace(-1, 1, 1030, dtype=np.float32))
    level = 400 + 60 * across - 25 * down + 30 * across * down
    frames = noisy(level, 5.0, 4, np.uint16)
    for k, frame in enumerate(frames):
        frame[700:703, 200 + 40 * k : 203 + 40 * k] += 300  # a star that passes
        frame[513, 700] = 900
    sky = sky_of(frames, bits=16)
    assert sky.sigma == pytest.approx(5.0, rel=0.01)
    away = np.abs(sky.mean[..., 0] - level)
    assert away[513, 700] > 400
    away[513, 700] = 0
    assert away.max() < 1.0


def test_what_every_frame_shows_is_sky():
    """A hot pixel, and a gradient of the light, are part of the mean."""
    gradient = 20 + 0.5 * np.arange(WIDTH) + np.zeros((HEIGHT, 1))
    frames = noisy(gradient, 2.0, 10)
    for frame in frames:
        frame[30, 40] = 200
    sky = sky_of(frames)
    assert sky.mean[30, 40, 0] == pytest.approx(200, abs=5)
    off = np.abs(sky.mean[..., 0] - gradient)
    off[30, 40] = 0
    assert off[5:-5, 5:-5].max() < 1.5
    assert np.median(off) < 0.3


def test_frames_may_differ_in_level():
    """Moonlight comes and goes: each frame's own level is taken out before they are compared."""
    frames = [frame for k in range(9) for frame in noisy(20.0 + 5 * k, 2.0, 1, seed=k)]
    sky = sky_of(frames)
    assert sky.sigma[0] == pytest.approx(2.0, rel=0.08)
    assert np.median(sky.mean) == pytest.approx(40, abs=0.6)


@pytest.mark.parametrize("count", [2, 5])
def test_a_sky_that_grows_light_from_one_side_is_no_noise(count):
    """At dusk: each frame's own plane is taken out, as it is of the frames that show the body."""
    across, down = np.meshgrid(np.linspace(-1, 1, 160), np.linspace(-1, 1, 120))
    dusk = [400 + 30 * across + 4 * (k - count / 2) * (1 + across + 0.5 * down) for k in range(count)]
    sky = sky_of([noisy(level, 5.0, 1, np.uint16, k)[0] for k, level in enumerate(dusk)], bits=16)
    assert sky.sigma == pytest.approx(5.0, rel=0.06)
    assert np.abs(sky.mean[..., 0] - np.median(dusk, axis=0)).mean() < 0.3 * 5.0


@pytest.mark.parametrize("sigma", [0.7, 1.0, 1.5, 2.0, 3.0, 6.0])
@pytest.mark.parametrize(("count", "tolerance"), [(1, 0.15), (10, 0.05), (20, 0.06)])
def test_the_noise_is_measured_between_whole_counts_too(sigma, count, tolerance):
    """The true deviation includes that of rounding, 1/12."""
    sky = sky_of(noisy(20.3, sigma, count))
    assert sky.sigma[0] == pytest.approx(np.hypot(sigma, np.sqrt(1 / 12)), rel=tolerance)


@pytest.mark.parametrize("enlarged", [1, 2, 4])
def test_noise_that_is_alike_in_neighbours_is_told_as_loud_as_it_is_over_squares(enlarged):
    """An enlarged image's pixels say no more than those that it was made of."""
    small = noisy(60.0, 4.0, 6)
    frames = [cv2.resize(frame, None, fx=enlarged, fy=enlarged, interpolation=cv2.INTER_CUBIC) for frame in small]
    assert sky_of(frames).sigma[0] == pytest.approx(4.0 * enlarged, rel=0.15)


def test_a_silent_sensor_still_has_the_noise_of_rounding():
    sky = sky_of([np.full((HEIGHT, WIDTH), 7, np.uint8)] * 4)
    np.testing.assert_array_equal(sky.sigma, [0.5])
    np.testing.assert_allclose(sky.mean, 7, atol=1e-4)


def test_sixteen_bits():
    sky = sky_of(noisy(3000.0, 40.0, 10, np.uint16), bits=16)
    assert sky.log_density.shape == (65536,)
    assert sky.sigma[0] == pytest.approx(40, rel=0.05)
    assert np.median(sky.mean) == pytest.approx(3000, abs=3)
    assert np.argmax(sky.log_density) == pytest.approx(3000, abs=60)


def test_colour_has_a_mean_and_a_noise_per_channel():
    level = np.broadcast_to(np.array([40.0, 90.0, 160.0]), (HEIGHT, WIDTH, 3))
    frames = noisy(level, 1.0, 10)
    for frame, extra in zip(frames, noisy(0.0 * level + 50, 4.0, 10, seed=5), strict=True):
        frame[..., 2] = frame[..., 2] + extra[..., 2] - 50
    sky = sky_of(frames)
    assert sky.mean.shape == (HEIGHT, WIDTH, 3)
    np.testing.assert_allclose(np.median(sky.mean, axis=(0, 1)), [40, 90, 160], atol=0.6)
    np.testing.assert_allclose(sky.sigma, [1.04, 1.04, np.hypot(1, 4)], rtol=0.06)
    assert sky.spec.name == "colour"
    assert np.exp(sky.log_density).sum() == pytest.approx(1)
