"""Skies of images that were compressed, made black, or that have a clock: what is noise, and what is not known."""

import cv2
import numpy as np
import pytest

from tests.unit.imaging.test_background import HEIGHT, WIDTH, noisy, sky_of


@pytest.mark.parametrize(("quality", "slope"), [(15, 6.0), (30, 0.0), (30, 6.0), (50, 0.0), (75, 0.0)])
def test_a_compressed_sky_has_the_noise_of_its_blocks(quality, slope):
    """Most of it is one value or two, and what differs jumps by whole blocks: no pixel's noise shows it."""
    level = np.tile(14.6 + slope * np.linspace(-0.5, 0.5, 8 * WIDTH), (8 * HEIGHT, 1))
    how = [cv2.IMWRITE_JPEG_QUALITY, quality]
    coded = [cv2.imencode(".jpg", frame, how)[1] for frame in noisy(level, 1.7, 6, seed=2)]
    frames = [cv2.imdecode(one, cv2.IMREAD_GRAYSCALE) for one in coded]
    blocks = 8 * (np.array(frames) - level).reshape(6, HEIGHT, 8, WIDTH, 8).mean(axis=(2, 4))
    jumps = np.diff(blocks, axis=0).std() / np.sqrt(2)
    assert jumps > 2.5
    assert 0.9 * jumps < sky_of(frames).sigma[0] < 1.1 * blocks.std()  # what stays may be in the mean


@pytest.mark.parametrize("count", [1, 6])
def test_blocks_that_stay_where_they_are_are_noise_as_well(count):
    """A video's codec leaves most of a still sky as it was: few frames tell no more of it than one."""
    rng = np.random.default_rng(6)
    blocks = 40 + np.kron(rng.choice([-1, 0, 1], (HEIGHT, WIDTH)), np.ones((8, 8)))
    frames = [np.asarray(blocks, np.uint8)] * count
    assert 5 < sky_of(frames).sigma[0] < 8 * np.sqrt(2 / 3)  # some of it is in the mean


@pytest.mark.parametrize("stars", [20, 60])
def test_passing_stars_are_no_noise(stars):
    """So many of 1,200 squares have one that is gone in the next frame."""
    frames, rng = noisy(np.full((4 * HEIGHT, 4 * WIDTH), 20.0), 2.0, 8), np.random.default_rng(4)
    for frame in frames:
        for y, x in zip(*rng.integers(0, 4 * HEIGHT - 3, (2, stars)), strict=True):
            frame[y : y + 3, x : x + 3] += np.uint8(60)
    assert sky_of(frames).sigma[0] == pytest.approx(2.0, rel=0.1)


def stamped(frame, text: str):
    out = frame.copy()
    cv2.putText(out, text, (4, HEIGHT - 8), cv2.FONT_HERSHEY_SIMPLEX, 0.3, 240, 1)
    return out


def test_where_a_clock_runs_nothing_is_known():
    """Its hours, which stand still in the empty frames, may change in the next; a date elsewhere stays as it is."""
    skies, digits = noisy(np.full((HEIGHT, WIDTH), 20.0), 2.0, 6), (318, 692, 145, 873, 507, 264)
    frames = [stamped(sky, f"07:11.{now}") for sky, now in zip(skies, digits, strict=True)]
    for frame in frames:
        cv2.putText(frame, "EAST", (4, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.3, 240, 1)
    unsure = sky_of(frames).unsure
    later = stamped(np.full((HEIGHT, WIDTH), 20, np.uint8), "19:48.935") > 60
    assert unsure is not None and unsure[later].all()
    assert not unsure[: HEIGHT // 2].any() and unsure.mean() < 0.25


def test_a_sky_without_a_clock_is_known_everywhere():
    """Neither noise, nor a star that passes, nor one that stays, nor hot pixels are more than sky."""
    frames = noisy(np.full((HEIGHT, WIDTH), 20.0), 2.0, 8)
    for k, frame in enumerate(frames):
        frame[10:13, 10 + 3 * k : 13 + 3 * k] += 90
        frame[30:33, 20:23] += 90
        frame[50, ::7] += 90
    assert sky_of(frames).unsure is None


def raised(frames, black: int):
    """With another black point."""
    return [np.clip(frame.astype(int) - black, 0, 255).astype(frame.dtype) for frame in frames]


@pytest.mark.parametrize("sigmas", [-1.0, 0.0, 1.0, 2.0])
@pytest.mark.parametrize("sigma", [2.0, 8.0])
def test_a_black_sky_has_the_noise_that_it_had(sigma, sigmas):
    """Of most pixels nothing is left, and stars are brighter than all that is."""
    frames, rng = noisy(np.full((4 * HEIGHT, 4 * WIDTH), 60.0), sigma, 6), np.random.default_rng(4)
    for frame in frames:
        for y, x in zip(*rng.integers(0, 4 * HEIGHT - 3, (2, 40)), strict=True):
            frame[y : y + 3, x : x + 3] += np.uint8(60)
    sky = sky_of(raised(frames, round(60 + sigmas * sigma)))
    assert sky.sigma[0] == pytest.approx(sigma, rel=0.2)
    assert sky.unsure is None


def test_channels_of_a_black_sky_are_as_alike_as_they_were():
    grey = noisy(np.full((4 * HEIGHT, 4 * WIDTH), 60.0), 5.0, 6)
    sky = sky_of([np.repeat(frame[..., None], 3, axis=2) for frame in raised(grey, 65)])
    assert sky.covariance == pytest.approx(np.full((3, 3), 25.0), rel=0.4)


def test_a_sky_without_any_noise_stays_so():
    assert sky_of([np.zeros((HEIGHT, WIDTH), np.uint8)] * 6).sigma[0] == 0.5


@pytest.mark.parametrize(("step", "sigma"), [(4, 1.5), (4, 3.0), (16, 100.0), (64, 20.0)])
def test_counts_that_go_by_steps_are_a_sky_as_any(step, sigma):
    """Posterised images, and cameras of 12 bits in 16: a level between two steps comes and goes everywhere."""
    frames = noisy(np.full((HEIGHT, WIDTH), 900.0 + 0.4 * step), sigma, 6, np.uint16)
    sky = sky_of([np.asarray(step * np.rint(frame / step), np.uint16) for frame in frames], bits=16)
    assert sky.unsure is None
    assert sky.mean.mean() == pytest.approx(900 + 0.4 * step, abs=0.3 * step)
    assert 0.9 * sigma < sky.sigma[0] < 1.2 * np.hypot(sigma, 0.5 * step)


def test_a_few_stars_are_no_steps():
    dark = [np.zeros((HEIGHT, WIDTH), np.uint8) for _ in range(6)]
    for frame in dark:
        frame[20, 30:32] = 120
    assert sky_of(dark).sigma[0] == 0.5


def test_a_channel_of_which_nothing_is_left_is_as_loud_as_the_others():
    frames = raised(noisy(np.full((4 * HEIGHT, 4 * WIDTH, 3), (60.0, 60.0, 20.0)), 5.0, 6), 62)
    assert sky_of(frames).sigma == pytest.approx([5.0, 5.0, 5.0], rel=0.2)
