"""What programs do to images before they are posted (``skypose bench track --altered``)."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from service.bench import altered as module
from service.bench.altered import ALTERATIONS, altered
from service.bench.brightness import pixels
from service.bench.folder import SequenceError
from service.cli.bench import Alteration
from service.simulate.folder import encode_png


def images(dtype=np.uint8, channels=()):
    """A bright square on a sky of level 15, one frame without it."""
    rng = np.random.default_rng(1)
    drawn = [np.rint(rng.normal(15, 1.7, (96, 64, *channels))) for _ in range(4)]
    for image in drawn[1:]:
        image[30:60, 20:44] += 150
    return [image.astype(dtype) for image in drawn]


def test_the_command_knows_them_all():
    assert set(get_args(Alteration)) == set(ALTERATIONS)


@pytest.mark.parametrize("how", ALTERATIONS)
@pytest.mark.parametrize("channels", [(), (3,)])
def test_a_pass_keeps_its_images_and_its_truth(case_of, satellite, truth, how, channels):
    empty, *seen = images(channels=channels)
    moments = [replace(truth, time_s=float(k)) for k in range(3)]
    case = replace(
        case_of(satellite),
        backgrounds=lambda: [encode_png(empty)],
        frames=lambda: zip(map(encode_png, seen), moments, strict=True),
    )
    changed = altered(case, how)
    (sky,), frames = list(changed.backgrounds()), list(changed.frames())
    assert [moment for _, moment in frames] == moments
    for k, (before, after) in enumerate(zip([empty, *seen], [sky, *(body for body, _ in frames)], strict=True)):
        image = pixels(after)
        assert image.dtype == np.uint8 and image.shape == before.shape
        above, was = (one - np.median(one) for one in (image.astype(float), before))  # black or not
        change = np.abs(above - was).mean()
        same = {"full": k == 0, "gain": k < 2}.get(how, False)  # no sky is so bright; later in the pass
        assert change < (20 if how == "gain" else 10) and (change == 0) == same
    assert list(changed.frames())[2][0] == frames[2][0]


@pytest.mark.parametrize("how", ["jpeg", "video", "denoised"])
def test_what_knows_eight_bits_leaves_sixteen_as_they_are(how):
    given = images(np.uint16)
    for before, after in zip(given, ALTERATIONS[how](given), strict=True):
        np.testing.assert_array_equal(after, before)


@pytest.mark.parametrize(("how", "least", "most"), [("jpeg", 0, 0.7), ("denoised", 0, 0.5), ("sharpened", 1.5, 4)])
def test_noise_of_neighbours(how, least, most):
    given = images()
    for images_ in zip(given, ALTERATIONS[how](given), strict=True):
        before, after = (np.diff(image[70:90].astype(float), axis=1).std() for image in images_)
        assert least <= after / before <= most


def test_of_a_black_sky_little_is_left():
    for before, after in zip(images(), ALTERATIONS["black"](images()), strict=True):
        assert 0.9 < (after[70:90] == 0).mean() < 1
        assert after.max() == before.max() - before[:20].max() + after[:20].max()


def test_a_sensor_is_full_where_half_of_what_is_lit_is():
    given = images()
    least = np.median(given[0]) + 6 * 1.5 * np.median(np.abs(given[0] - np.median(given[0])))
    seen = np.stack(ALTERATIONS["full"](given)[1:])
    assert 0.5 <= (seen == seen.max()).sum() / (seen > least).sum() < 0.7  # of as many a count
    dark = [given[0]] * 3
    assert all(one is other for one, other in zip(ALTERATIONS["full"](dark), dark, strict=True))


@pytest.mark.parametrize(("dtype", "step"), [(np.uint8, 4), (np.uint16, 64)])
def test_steps(dtype, step):
    for image in ALTERATIONS["steps"](images(dtype))[1:]:
        assert image.max() > 0 and not (image % step).any()


def test_bars_stay_and_a_stabilised_window_moves():
    given = images()
    bars, moved = ([one == 0 for one in ALTERATIONS[how](given)] for how in ("bars", "stabilised"))
    assert all((one == bars[0]).all() for one in bars) and bars[0][:14].all() and bars[0][-14:].all()
    assert not bars[0][15:-15].any()
    assert all(0 < one.mean() < 0.4 for one in moved) and any((one != moved[0]).any() for one in moved)


def test_a_clock_goes_on_in_its_corner():
    given = images()
    first, second, *_ = ALTERATIONS["clock"](given)
    np.testing.assert_array_equal(second[:70], given[1][:70])
    assert (first[80:] > 200).any() and ((first[80:] > 200) != (second[80:] > 200)).any()


def test_without_the_codec_it_says_so(monkeypatch):
    monkeypatch.setattr(module, "_CODEC", "none")
    with pytest.raises(SequenceError, match="no codec none"):
        ALTERATIONS["video"](images())
