"""What a patch must hold: the light that a body should show, and the light that is seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from lit_body import SUN, VIEW, lit_body, pose, seen, shares
from lit_search import dark_sight

from service.inference.model.candidates import turned_alike
from service.inference.model.drawing import Lens
from service.inference.model.expected import lit_box
from service.inference.model.paint import unlearnt
from service.inference.pose import retract


def test_the_box_holds_the_light_and_little_more():
    image = seen(pose(), shares(lit_body(), 900.0, even=(0.0,) * 4), core=0.4)
    box = lit_box(lit_body(), pose(), SUN[None])
    assert box is not None
    rows, columns = np.nonzero(image > 0.02 * image.max())
    wanted = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])
    np.testing.assert_allclose(box, np.tile(VIEW.origin, 2) + VIEW.binning * wanted, atol=3.0 * VIEW.binning)


def test_a_surface_that_is_known_to_be_dark_is_no_part_of_it():
    whole = lit_box(lit_body(), pose(), SUN[None])
    sizes = []
    for group in range(lit_body().n_groups):
        paint = unlearnt(4 + 2 * lit_body().n_groups)
        paint[:, [group, lit_body().n_groups + group]] = np.array([[-8.0], [1e6]])
        box = lit_box(lit_body(), pose(), SUN[None], paint)
        assert whole is not None and box is not None
        sizes.append(float(np.prod(box[2:] - box[:2])))
    assert min(sizes) < 0.9 * float(np.prod(whole[2:] - whole[:2]))


def test_a_body_that_shows_no_light_has_no_box():
    assert lit_box(lit_body(), pose(), -SUN[None] * np.array([1.0, 1.0, -1.0])) is not None
    behind = np.array([[0.0, 0.0, 1.0]])
    assert lit_box(lit_body(), pose(), behind) is None


def test_a_sight_grows_by_light_that_lies_where_a_body_should_show_some():
    pieces = np.array([[42.0, 52.0, 58.0, 68.0], [74.0, 58.0, 80.0, 62.0], [90.0, 90.0, 94.0, 94.0]])
    sight = replace(dark_sight(), centre=(50.0, 60.0), span=20.0, pieces=pieces)
    for box in (None, np.array([45.0, 55.0, 60.0, 70.0]), np.array([100.0, 0.0, 120.0, 20.0])):
        same = sight.over(lambda lens, box=box: box)
        assert (same.centre, same.span) == (sight.centre, sight.span)
    grown = sight.over(lambda lens: np.array([45.0, 55.0, 85.0, 65.0]))
    assert (grown.centre, grown.span) == ((60.0, 60.0), 40.0)


def test_a_sight_that_leaves_nothing_out_asks_for_no_box():
    def asked(lens: Lens | None) -> None:
        raise AssertionError

    sight = replace(dark_sight(), centre=(50.0, 60.0), span=20.0)
    assert sight.over(asked).span == 20.0
    assert replace(sight, pieces=np.array([[42.0, 52.0, 58.0, 68.0]])).over(asked).span == 20.0


@pytest.mark.parametrize(("turn_deg", "joint_deg", "alike"), [(4, 15, True), (6, 0, False), (0, 30, False)])
def test_another_look_at_a_pose_points_where_it_does_with_its_joints(turn_deg, joint_deg, alike):
    step = np.zeros((1, 7))
    step[0, 1], step[0, 6] = np.deg2rad(turn_deg), joint_deg
    assert turned_alike(retract(pose(), step), pose(), lit_body().articulation) == [alike]
