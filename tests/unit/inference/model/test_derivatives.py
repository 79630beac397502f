"""Derivatives of a picture against differences of whole pictures, drawn one by one."""

from dataclasses import replace

import numpy as np
import pytest
from lit_body import SUN, VIEW, lit_body, pose, shares

from service.inference.model.derivatives import across, derivatives, steps_of
from service.inference.model.drawing import Lens, Quality, View
from service.inference.model.spread import PointSpread, spread
from service.inference.pose import concatenate, retract
from service.inference.state import Poses

FINE = Quality(supersample=12, shadow_px=768)
BLUR = (PointSpread(1.3, 0.6), 0.9)
OTHER_SUN = np.array([-0.4, 0.5, -0.2]) / np.linalg.norm([-0.4, 0.5, -0.2])


def blurred(at: Poses, sun: np.ndarray, light: np.ndarray, view: View) -> np.ndarray:
    return spread(lit_body().combined(at, sun, light, view, FINE), *BLUR)[0].astype(float)


def by_hand(at: Poses, sun: np.ndarray, light: np.ndarray, sun_free: bool, view: View = VIEW) -> np.ndarray:
    turn, joint = steps_of(lit_body(), VIEW, 0.5, at)
    out = []
    for k, step in enumerate([turn[0], turn[0], turn[0], 0.5, 0.5, turn[0], joint[0, 0]]):
        move = np.zeros((1, 7))
        move[0, k] = step
        pictures = [blurred(retract(at, sign * move), sun, light, view) for sign in (1, -1)]
        out.append((pictures[0] - pictures[1]) / (2 * step))
    for axis in across(sun) if sun_free else ():
        both = [(sun + sign * 0.03 * axis) / np.linalg.norm(sun + sign * 0.03 * axis) for sign in (1, -1)]
        out.append((blurred(at, both[0], light, view) - blurred(at, both[1], light, view)) / 0.06)
    return np.array(out)


@pytest.mark.parametrize("sun_free", [True, False])
@pytest.mark.parametrize("sun", [SUN, OTHER_SUN])
@pytest.mark.parametrize("view", [VIEW, replace(VIEW, around=(0.2, -0.3, -0.1, 0.2))], ids=["sunlit", "earthlit too"])
def test_they_are_those_of_whole_pictures(view, sun, sun_free):
    both = concatenate(pose(), pose(turn=(-1.1, 0.5, 1.9), joint=-60.0, middle=(29.3, 34.8)))
    light = shares(lit_body(), 300.0)
    suns, lights = np.tile(sun, (2, 1)), np.tile(light, (2, 1))
    found = derivatives(lit_body(), view, FINE, BLUR, both, suns, lights, difference=0.5, sun_free=sun_free)
    assert found.shape[1] == (9 if sun_free else 7)
    for k in range(2):
        wanted = by_hand(both[k : k + 1], sun, light, sun_free, view)
        error = np.sqrt(((found[k] - wanted) ** 2).mean(axis=(1, 2)) / (wanted**2).mean(axis=(1, 2)))
        assert error.max() < 0.06, error


@pytest.mark.parametrize("lens", [None, Lens(90.0, (150.0, 70.0))])
@pytest.mark.parametrize("sun_free", [True, False])
def test_the_device_mixes_them_as_its_twin_does(sun_free, lens):
    both = concatenate(pose(), pose(turn=(-1.1, 0.5, 1.9), joint=-60.0, middle=(9.3, 54.8)))  # half out of the patch
    view, drawn = replace(VIEW, lens=lens), (both, np.tile(SUN, (2, 1)), np.tile(shares(lit_body(), 300.0), (2, 1)))
    given = view, FINE, BLUR, *drawn, 0.5, sun_free
    found, wanted = derivatives(lit_body(), *given), derivatives(replace(lit_body(), slopes=None), *given)
    assert found.shape == wanted.shape
    size = np.abs(wanted).max(axis=(0, 2, 3))
    assert (np.abs(found - wanted).max(axis=(0, 2, 3)) < 1e-5 * size).all()


def test_bodies_that_do_not_show_change_nothing():
    away = replace(pose(), position=np.array([[-900.0, 0.0]]))
    given = away, SUN[None], shares(lit_body(), 300.0)[None]
    assert not derivatives(lit_body(), VIEW, FINE, BLUR, *given, difference=0.5, sun_free=True).any()


@pytest.mark.parametrize("sun_free", [True, False])
def test_so_they_are_through_a_lens(sun_free):
    view, at = replace(VIEW, lens=Lens(90.0, (150.0, 70.0))), pose()
    light = shares(lit_body(), 300.0)
    given = at, SUN[None], light[None]
    found = derivatives(lit_body(), view, FINE, BLUR, *given, difference=0.5, sun_free=sun_free)[0]
    wanted = by_hand(at, SUN, light, sun_free, view)
    assert found.shape == wanted.shape
    assert np.abs(found - wanted).max() < 1e-3 * np.abs(wanted).max()
    assert not np.allclose(found[5], by_hand(at, SUN, light, sun_free)[5], atol=0.1 * np.abs(wanted[5]).max())


def test_places_are_those_of_the_frame_where_pixels_are_binned():
    view = replace(VIEW, binning=2.0, side=32)
    given = (pose(), SUN[None], shares(lit_body(), 300.0)[None])
    found = derivatives(lit_body(), view, FINE, BLUR, *given, difference=0.5, sun_free=True)[0]
    move = np.array([[0, 0, 0, 0.5, 0, 0, 0]])
    images = [
        spread(lit_body().combined(retract(pose(), sign * move), SUN, given[2][0], view, FINE), *BLUR)[0]
        for sign in (1, -1)
    ]
    wanted = images[0] - images[1]
    assert np.abs(found[3] - wanted).max() < 0.03 * np.abs(wanted).max()
