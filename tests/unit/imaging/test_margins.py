"""Black bars, borders of a stabilised video, what lies outside of an eyepiece: nothing is known there."""

import numpy as np
import pytest

from service.imaging.margins import either, margins_of, margins_under
from service.imaging.own_sky import own_sky
from service.imaging.patch import light_of
from tests.unit.imaging.test_background import noisy, sky_of

SIDE = 128
BODY = slice(50, 70), slice(55, 80)


def bars() -> np.ndarray:
    shown = np.zeros((SIDE, SIDE), bool)
    shown[20:-20] = True
    return shown


def eyepiece() -> np.ndarray:
    y, x = np.ogrid[:SIDE, :SIDE]
    return np.asarray(np.hypot(y - SIDE / 2, x - SIDE / 2) < 55)


def window(x: int, y: int) -> np.ndarray:
    shown = np.zeros((SIDE, SIDE), bool)
    shown[12 + y : SIDE - 12 + y, 12 + x : SIDE - 12 + x] = True
    return shown


def skies(count: int = 6) -> list[np.ndarray]:
    return noisy(np.full((SIDE, SIDE), 20.0), 2.0, count)


def with_body(frame: np.ndarray) -> np.ndarray:
    out = frame.copy()
    out[BODY] += 90
    return out


@pytest.mark.parametrize("shown", [bars(), eyepiece()], ids=["bars", "eyepiece"])
def test_what_no_frame_shows_is_unsure_and_no_noise(shown):
    sky = sky_of([frame * shown for frame in skies()])
    assert sky.sigma[0] == pytest.approx(2.0, rel=0.05)
    assert sky.unsure is not None and sky.unsure[~shown].all()
    assert sky.unsure[shown].mean() < 0.12  # a rim
    assert np.abs(sky.mean - 20).max() < 1


@pytest.mark.parametrize("shown", [bars(), eyepiece()], ids=["bars", "eyepiece"])
def test_light_between_margins_is_what_it_is_without_them(shown):
    *empty, frame = skies(7)
    sky, whole = sky_of([one * shown for one in empty]), sky_of(empty)
    found, wanted = light_of(with_body(frame) * shown, sky, 8), light_of(with_body(frame), whole, 8)
    assert found.unseen[~shown].all() and not found.image[~shown].any()
    inside = shown & ~found.unseen
    assert np.abs(found.image - wanted.image)[inside].max() < 1.5
    assert inside[BODY].all()


def test_margins_that_move_are_known_from_other_frames():
    places = [(-9, 3), (4, -11), (8, 8), (-2, -6), (0, 5), (6, -1)]  # one leaves a line that is dark
    empty = [frame * window(*at) for frame, at in zip(skies(), places, strict=True)]
    sky = sky_of(empty)
    assert sky.sigma[0] == pytest.approx(2.0, rel=0.1)
    assert sky.unsure is None or sky.unsure[14:-14, 14:-14].sum() == 0
    shown = window(7, -8)
    found = light_of(with_body(skies(7)[6]) * shown, sky, 8)
    assert found.unseen[~shown].all()
    assert np.abs(found.image[shown & ~found.unseen]).max() > 80
    assert not found.unseen[BODY].any()


@pytest.mark.parametrize("shown", [bars(), eyepiece()], ids=["bars", "eyepiece"])
def test_a_sky_of_the_frames_own_is_that_between_the_margins(shown):
    sky, known = own_sky(with_body(skies(1)[0]) * shown, 8)
    assert known.any() and not known[~shown].any() and not known[BODY].any()
    assert np.abs(sky.astype(float) - 20)[BODY].max() < 3


def test_a_black_sky_is_no_margin():
    """Restored photographs have nothing but zeros about the body, which may fill most of the image."""
    photograph = np.zeros((SIDE, SIDE, 1), np.uint8)
    photograph[20:100, 20:100] = 120
    photograph[19:101, 19] = photograph[19:101, 100] = photograph[19, 19:101] = photograph[100, 19:101] = 1
    photograph[18:102, 18] = photograph[18:102, 101] = photograph[18, 18:102] = photograph[101, 18:102] = 1
    photograph[17:103, 17] = photograph[17:103, 102] = photograph[17, 17:103] = photograph[102, 17:103] = 1
    assert margins_of(photograph, empty=False) is None
    assert margins_of(np.zeros((SIDE, SIDE, 1), np.uint8), empty=True) is None
    black = noisy(np.full((SIDE, SIDE), -4.0), 3.0, 1)[0]
    assert margins_of(black[..., None], empty=True) is None


def test_a_sky_as_dark_as_the_least_count_has_no_margins():
    frame = np.zeros((SIDE, SIDE, 1), np.uint8)
    frame[60:64, 60:64] = 200
    mean = np.full((SIDE, SIDE, 1), 0.5, np.float32)
    assert margins_under(frame, mean, np.array([0.5])) is None
    assert margins_under(frame, mean + 30, np.array([0.5])) is not None


def test_a_dark_body_before_a_bright_sky_is_no_margin():
    frame = noisy(np.full((SIDE, SIDE), 90.0), 3.0, 1)[0][..., None]
    frame[BODY] = 0
    assert margins_under(frame, np.full((SIDE, SIDE, 1), 90.0, np.float32), np.array([3.0])) is None


def test_two_of_them_together():
    one, other = np.eye(2, dtype=bool), np.zeros((2, 2), bool)
    assert either(None, None) is None
    assert either(one, None) is one and either(None, one) is one
    assert np.array_equal(either(one, other), one)
