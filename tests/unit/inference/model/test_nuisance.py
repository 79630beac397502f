"""Point spread, discrepancy and photon transfer of a frame: what explains it best at its best poses."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from lit_body import QUALITY, SUN, VIEW, lit_body, pose, scene, seen, shares

from service.inference.model.nuisance import (
    Nuisance,
    best_discrepancy,
    best_hidden,
    best_photon,
    best_spread,
    highest,
    neighbour,
)
from service.inference.model.spread import PointSpread
from service.inference.numerics.hill import Hill, looked
from service.inference.numerics.priors import PosePrior
from service.inference.pose import concatenate, retract
from service.inference.state import Poses

SIGMA = 4.0


def hill(image: np.ndarray, start: Nuisance, **others) -> Hill:
    noisy = image + np.random.default_rng(2).normal(0, SIGMA, image.shape)
    given = scene(noisy, SIGMA, start.core, start.wings, low_pass=1.0, **others)
    return Hill(given, lit_body(), VIEW, PosePrior(towards_sun=SUN), QUALITY)


def some() -> Poses:
    """The truth behind a pose that explains little."""
    return concatenate(retract(pose(), np.array([[0.5, -0.4, 0.3, 4.0, 3.0, 0.1, 30.0]])), pose())


@pytest.mark.parametrize(("core", "wings"), [(0.9, 0.0), (1.9, 0.0), (1.0, 1.3)])
@pytest.mark.parametrize("first", [0.8, 2.4])
def test_the_point_spread_is_found_from_either_side(core, wings, first):
    start = Nuisance(first, 0.4, 0.05)
    image = seen(pose(), shares(lit_body(), 900.0), core=core, wings=wings)
    found = best_spread(looked(hill(image, start), some(), np.tile(SUN, (2, 1))), start)
    wanted = Nuisance(core, wings)
    assert found.point_spread(1.0).width == pytest.approx(wanted.point_spread(1.0).width, rel=0.2)
    assert found.discrepancy == start.discrepancy


def test_turbulence_is_met_from_a_core_that_is_as_wide():
    """A valley: with a little less core, or a little more of wings, either by itself, the width is lost first."""
    wide = PointSpread(0.8, 2.0)
    start = Nuisance(wide.width, 0.0, 0.01)
    image = seen(pose(), shares(lit_body(), 900.0), core=wide.core, wings=wide.wings)
    found = best_spread(looked(hill(image, start, discrepancy=0.01), pose(), SUN[None]), start).point_spread(1.0)
    assert found.share > 0.6 and found.width == pytest.approx(wide.width, rel=0.2)


@pytest.mark.parametrize(("amount", "mask"), [(1.5, 2.0), (1.0, 1.4), (3.3, 1.0)])
def test_sharpening_is_found(amount, mask):
    start = Nuisance(0.8, 0.0, 0.01)
    image = seen(pose(), shares(lit_body(), 900.0), core=1.2)
    image += amount * (image - cv2.GaussianBlur(image, (0, 0), mask))
    found = best_spread(looked(hill(image, start, discrepancy=0.01), pose(), SUN[None]), start).point_spread(1.0)
    k = np.linspace(0.2, 1.5, 20)
    assert found.sharpened > 0
    assert found.transfer(k) == pytest.approx(PointSpread(1.2, 0.0, amount, mask).transfer(k), abs=0.12 * (1 + amount))


@pytest.mark.parametrize("core", [0.6, 1.2, 3.0])
def test_what_was_not_sharpened_has_no_ringing(core):
    """Where widths lie between those of the grid, a mask narrower than they are may make up for it."""
    start = Nuisance(1.2, 0.0, 0.02)
    image = seen(pose(), shares(lit_body(), 900.0), core=core)
    found = best_spread(looked(hill(image, start), some(), np.tile(SUN, (2, 1))), start).point_spread(1.0)
    assert found.transfer(np.linspace(0.0, 1.5, 31)).max() == pytest.approx(1.0)


def test_the_point_spread_of_an_enlarged_image_is_found():
    start = Nuisance(3.0, 0.0, 0.05)
    image = seen(pose(), shares(lit_body(), 900.0), core=6.0)
    at = looked(hill(image, start), some(), np.tile(SUN, (2, 1)))
    assert best_spread(at, start).core == pytest.approx(6.0, rel=0.15)


@pytest.mark.parametrize(("core", "wings"), [(0.9, 0.0), (2.5, 0.0), (1.0, 1.3)])
def test_no_light_is_sharper_than_its_point_spread(core, wings):
    image = seen(pose(), shares(lit_body(), 900.0), core=core, wings=wings)
    given = hill(image, Nuisance(core, wings)).scene
    width = PointSpread(core, wings).width
    assert given.lets_through(PointSpread(core, wings)) and given.lets_through(PointSpread(0.5 * width))
    assert not given.lets_through(PointSpread(4 * width))
    struck = image.copy()
    struck[30, 40:42] += 5000.0  # a cosmic ray
    assert hill(struck, Nuisance(core, wings)).scene.lets_through(PointSpread(core, wings))


def test_a_wrong_pose_asks_for_no_blur_that_the_frame_cannot_have():
    wide = Nuisance(12.0, 0.0, 0.02)
    given = hill(seen(pose(), shares(lit_body(), 900.0), core=0.9), wide)
    wrong = retract(pose(), np.array([[1.0, -0.7, -1.4, 3.8, 7.9, 0.1, 6.4]]))
    assert best_spread(looked(given, wrong, SUN[None]), wide).core < 2.5  # 11.4 where all is allowed


def test_a_mesh_that_is_further_from_right_has_more_discrepancy():
    """Paint that the model does not know of: bright and dark patches all over the body."""
    found = []
    clean = seen(pose(), shares(lit_body(), 900.0))
    rough = np.random.default_rng(5).normal(size=(8, 8)).repeat(8, axis=0).repeat(8, axis=1)
    for share in (0.0, 0.05, 0.3):
        start = Nuisance(1.3, 0.0)
        on = hill(clean * (1 + share * rough), start)
        found.append(best_discrepancy(looked(on, some(), np.tile(SUN, (2, 1))), start).discrepancy)
    assert found == sorted(found)
    assert found[0] < found[2]


@pytest.mark.parametrize("seen_as", [1.0, 4.0])
def test_the_noise_of_photons_is_found_where_edges_look_like_it(seen_as):
    photon, start = 1.5, Nuisance(1.3, 0.0, 0.001)
    clean = seen(pose(), shares(lit_body(), 900.0))
    noise = np.random.default_rng(3).normal(0, 1, clean.shape) * np.sqrt(photon * clean)
    on = hill(clean + noise, start, discrepancy=0.001, seen_photon=seen_as * photon)
    found = best_photon(looked(on, some(), np.tile(SUN, (2, 1))), start).photon
    assert found is not None and photon / 1.5 < found / VIEW.binning**2 < 1.5 * photon


def test_a_body_hides_no_more_of_the_sky_than_its_noise_allows():
    one = replace(scene(np.zeros((64, 64)), 2.0), sky=100.0, photon=0.1)
    assert one.hidden == pytest.approx(1.5 * 2.0**2 / 0.1)
    assert one.under(photon=0.01).hidden == 100.0


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_the_sky_that_a_body_hides_is_one_number_for_the_frame(share):
    """Of a pose alone it is free: more light and more hidden sky is all but the same image."""
    sky, coefficients = 60.0, shares(lit_body(), 40.0)
    coefficients[lit_body().n_groups] -= share * sky
    on = hill(seen(pose(), coefficients), Nuisance(1.3), discrepancy=0.02, sky=sky, photon=0.05)
    at = looked(on, some(), np.tile(SUN, (2, 1)))
    found = best_hidden(at, Nuisance(1.3))
    assert found.hides == pytest.approx(share * sky, abs=0.1 * sky)
    assert best_hidden(at, replace(found, hides=share * 0.9 * sky)).hides == pytest.approx(share * sky, abs=0.1 * sky)
    for photon in (0.05, 0.6):  # another photon transfer lets less of the sky be hidden, not another light
        under = on.scene.under(hides=found.hides, photon=photon)
        held = at.on(replace(on, scene=under)).values[1, lit_body().n_groups * 2 + 2] * under.hidden
        assert held == pytest.approx(min(found.hides, under.hidden), abs=0.03 * sky)


def test_every_fifth_frame_tries_a_neighbour_of_each():
    start = Nuisance(1.3, 0.4, 0.02, 0.5, 30.0)
    tried = [neighbour(start, turn, 60.0) for turn in range(10)]
    for name in ("discrepancy", "photon", "hides"):
        told = [getattr(one, name) for one in tried]
        assert [value != getattr(start, name) for value in told].count(True) == 2
        assert min(told) < getattr(start, name) < max(told)
    assert neighbour(replace(start, hides=0.0), 4, 60.0).hides == 0.0
    unknown = Nuisance(1.3, 0.4, 0.02)
    assert all(neighbour(unknown, turn, 60.0).hides is None for turn in range(10))


def test_squares_of_pixels_make_the_point_spread_smaller():
    one = replace(Nuisance(2.0, 1.0), discrepancy=0.1)
    assert one.point_spread(2.0).core == 1.0 and one.point_spread(2.0).wings == 0.5


@pytest.mark.parametrize("count", [1, 2, 9, 17])
def test_the_top_of_a_grid_is_found_without_a_look_at_all_of_it(count):
    for top in range(count):
        for start in range(count):
            looks: list[int] = []

            def values(places: list[int], top: int = top, looks: list[int] = looks) -> np.ndarray:
                looks.extend(places)
                return -np.abs(np.array(places, dtype=float) - top)

            assert highest(values, start, count) == top
            assert len(looks) == len(set(looks)) <= 5 + abs(top - start) / 3 + 3
