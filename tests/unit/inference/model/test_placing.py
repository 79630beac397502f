"""A picture's place in a frame, before anything else of its light is fitted."""

from dataclasses import replace

import numpy as np
import pytest
from lit_body import FINEST, QUALITY, SIDE, SUN, VIEW, lit_body, pose, scene, seen, shares

from service.inference.model.paint import unlearnt
from service.inference.model.scene import Scene
from service.inference.numerics.hill import Hill
from service.inference.numerics.placing import _move, _start, placed
from service.inference.numerics.priors import Believed, PosePrior
from service.inference.pose import concatenate
from service.inference.state import Poses

SIGMA, SKY = 4.0, 60.0
OFF = np.array([[2.6, -1.7]])


def frame(more: np.ndarray | float = 0.0, gain: float = 700.0, **others) -> Scene:
    image = seen(pose(), shares(lit_body(), gain)) + more
    image = image + np.random.default_rng(1).normal(0, SIGMA, image.shape)
    return scene(image, SIGMA, **({"low_pass": FINEST} | others))


def found(given: Scene, starts: Poses, sigma_px: float = 5.0) -> Poses:
    """Of a track whose place is known to ``sigma_px``."""
    hill = Hill(given, lit_body(), VIEW, PosePrior(towards_sun=SUN), quality=QUALITY)
    n = len(starts)
    precision = np.tile(np.diag([1e4] * 3 + [sigma_px**-2] * 2 + [1e4, 1.0]), (n, 1, 1))
    n_planes = hill.drawing.planes(starts[:1], SUN, VIEW, QUALITY).shape[1]
    paint, suns = np.tile(unlearnt(n_planes), (n, 1, 1)), np.tile(SUN, (n, 1))
    return placed(hill, starts, suns, Believed(starts, precision, np.array([True]), paint, suns, np.zeros(n)))


def moved(off: np.ndarray) -> Poses:
    return replace(pose(), position=pose().position + off)


def test_a_body_that_jumped_is_where_its_light_is():
    out = found(frame(), concatenate(moved(OFF), moved(-OFF), pose()))
    np.testing.assert_allclose(out.position, np.repeat(pose().position, 3, 0), atol=0.2)
    np.testing.assert_array_equal(out.quaternion, np.repeat(pose().quaternion, 3, 0))


def covering() -> np.ndarray:
    """Coefficients of the body's coverage."""
    cover = np.zeros(len(shares(lit_body(), 1.0)), np.float32)
    cover[lit_body().n_groups] = 1.0
    return cover


def by_day(gain: float = 15.0) -> Scene:
    """A body darker than the sky, of which it hides more than is expected."""
    return frame(-0.8 * SKY * seen(pose(), covering()), gain=gain, sky=SKY)


@pytest.mark.parametrize("gain", [15.0, 0.0])
def test_by_day_a_body_is_where_the_sky_is_hidden(gain):
    day = by_day(gain)
    assert day.data.min() < -20.0 and day.gain < np.log(SKY)
    out = found(day, concatenate(moved(OFF), moved(-OFF), pose()))
    np.testing.assert_allclose(out.position, np.repeat(pose().position, 3, 0), atol=0.5)


def hides_nothing() -> Scene:
    """Of a sky brighter than a white surface, most of it what the sensor adds; the body shows light from all sides."""
    return frame(0.05 * 700.0 * seen(pose(), covering()), sky=3000.0)


def test_a_body_that_hides_less_than_nothing_stays_where_it_is():
    """It is brighter in its midst than is expected, which best goes with less than nothing that is hidden."""
    y, x = np.mgrid[:SIDE, :SIDE] - SIDE / 2
    wide, narrow = (np.exp(-(x**2 + y**2) / (2 * s**2)).astype(np.float32) for s in (6.0, 4.0))
    parts = np.zeros((2, 3, SIDE, SIDE), np.float32)
    parts[0, 0], parts[1, 0] = wide, -3000.0 * narrow
    given = scene(60 * wide + 200 * narrow, SIGMA, sky=3000.0, low_pass=FINEST)
    terms = Hill(given, lit_body(), VIEW, PosePrior()).terms
    assert not _start(terms, parts, 1e-4 * np.eye(2), np.zeros(2)).any()


@pytest.mark.parametrize("given", [frame, by_day, hides_nothing])
def test_a_jump_by_more_than_steps_can_follow(given):
    """By day, too: a body darker than the sky is dark where it lies."""
    out = found(given(), moved(np.array([[13.0, -9.0]])), sigma_px=50.0)
    np.testing.assert_allclose(out.position, pose().position, atol=0.5)


def test_what_is_known_of_its_place_counts():
    out = found(frame(), moved(OFF), sigma_px=1e-4)
    np.testing.assert_allclose(out.position, moved(OFF).position, atol=0.01)


@pytest.mark.parametrize("gain", [0.0, -700.0])
def test_where_there_is_no_light_it_stays(gain):
    out = found(frame(gain=gain), moved(OFF), sigma_px=0.5)
    assert np.abs(out.position - moved(OFF).position).max() < 1.0


@pytest.mark.parametrize("given", [frame, by_day])
def test_a_body_that_is_expected_outside_of_the_patch_stays_there(given):
    away = moved(np.array([[500.0, 0.0]]))
    np.testing.assert_array_equal(found(given(), away).position, away.position)


def test_unlit_before_the_sky_it_is_where_the_sky_is_hidden():
    """Its light's picture is empty, and nothing is divided by it."""
    parts = np.zeros((2, 3, SIDE, SIDE), np.float32)
    y, x = np.mgrid[:SIDE, :SIDE] - SIDE / 2
    blob = -SKY * np.exp(-(x**2 + y**2) / 50)
    parts[1] = blob, -x / 25 * blob, -y / 25 * blob
    terms = Hill(scene(np.roll(blob, 2, 1), SIGMA, sky=SKY, low_pass=FINEST), lit_body(), VIEW, PosePrior()).terms
    move = _move(terms, parts, 1e-4 * np.eye(2), np.zeros(2), 5.0, 0.5)
    assert move == pytest.approx([2.0, 0.0], abs=0.2)


def test_a_star_beside_it_does_not_draw_it_away():
    star, pieces = np.zeros((SIDE, SIDE)), np.zeros((SIDE, SIDE), np.uint8)
    star[8:11, 8:11], pieces[7:12, 7:12] = 3e3, 1
    out = found(frame(star, starry=pieces), moved(OFF))
    np.testing.assert_allclose(out.position, pose().position, atol=0.2)


def test_pixels_that_are_full_hold_at_least_so_much():
    image = seen(pose(), shares(lit_body(), 700.0))
    full = image > np.quantile(image, 0.97)
    out = found(frame(np.where(full, image.max() - image - 200.0, 0.0), full=full), moved(OFF))
    np.testing.assert_allclose(out.position, pose().position, atol=0.3)
