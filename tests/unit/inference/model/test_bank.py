"""Templates: rotations over all of SO(3), pictures brought to one place and size, and the frame held against them."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from lit_body import SUN, lit_body
from scipy.spatial.transform import Rotation

from service.inference.articulation import Joint
from service.inference.model import bank as banks
from service.inference.model.drawing import View
from service.inference.model.prior import LightPrior
from service.inference.model.templates import (
    KINDS,
    SIDE,
    Bank,
    drawn_joints,
    kinds_of,
    lit_moments,
    normalised,
    rotations,
)
from service.inference.pose import angle_between
from service.inference.state import Poses

COUNT = 400
PATCH = View((0.0, 0.0), 1.0, 96)
SIGMA = 2.0


@functools.cache
def bank() -> Bank:
    return banks.build(lit_body(), np.tile(SUN, (COUNT, 1)), None, LightPrior().whole)


def frame(k: int, rim_px: float, middle: tuple[float, float]) -> tuple[Poses, np.ndarray]:
    """A template's pose elsewhere and at another size, and what a camera sees of it."""
    of = bank().poses[k : k + 1]
    at = Poses(of.quaternion, np.array([middle]), np.log([rim_px / lit_body().radius]), of.joints)
    drawing = lit_body()
    drawn = drawing.shaded.pictures(drawing.transforms(at, PATCH), SUN, side=96, supersample=3, shadow_px=128)[0, 0]
    return at, (200.0 * drawn + np.random.default_rng(k).normal(0, SIGMA, drawn.shape)).astype(np.float32)


def nearest_deg(of: np.ndarray, among: np.ndarray, own: bool) -> np.ndarray:
    """(N,) angle to the nearest rotation, not itself where it is one of them."""
    dot = np.abs(of @ among.T)
    if own:
        dot[np.arange(len(of)), np.arange(len(of))] = 0.0
    return np.rad2deg(2 * np.arccos(np.clip(dot.max(axis=1), 0, 1)))


def test_rotations_lie_evenly_over_all_of_them():
    spiral = rotations(4500)
    assert np.linalg.norm(spiral, axis=1) == pytest.approx(1.0)
    apart = nearest_deg(spiral, spiral, own=True)
    assert apart.max() < 16.0
    assert apart.min() > 6.0
    anywhere = Rotation.random(1500, random_state=2).as_quat()
    away = nearest_deg(anywhere, spiral, own=False)
    assert away.max() < 16.0


def test_joints_are_drawn_evenly_over_their_ranges():
    articulation = lit_body().articulation
    short = replace(articulation.joints[0], minimum=-10.0, maximum=30.0)
    both = replace(articulation, joints=(articulation.joints[0], short))
    found = drawn_joints(both, 1000)
    for values, joint in zip(found.T, both.joints, strict=True):
        counts, _ = np.histogram(values, 10, (joint.minimum, joint.maximum))
        assert counts.min() > 80 and counts.max() < 120
    assert abs(np.corrcoef(found.T)[0, 1]) < 0.05
    assert drawn_joints(replace(articulation, joints=()), 7).shape == (7, 0)


def test_a_body_of_many_joints_has_them_all_drawn():
    articulation = lit_body().articulation
    joints = tuple(Joint(f"j{k}", "revolute", 0.0, 1.0, 0.0, ()) for k in range(20))
    found = drawn_joints(replace(articulation, joints=joints), 2000)
    assert found.shape == (2000, 20)
    assert np.abs(np.mean(found, axis=0) - 0.5).max() < 0.05


def test_moments_are_of_what_is_lit():
    image = np.zeros((2, 32, 32), np.float32)
    image[0, 4:8, 10:20] = 5.0
    image[0, 20, 20] = 0.01  # next to dark
    image[1, 16, 16] = 1.0
    middle, rim = lit_moments(image)
    assert middle[0] == pytest.approx((15.0, 6.0))
    x, y = (np.arange(a, b) + 0.5 - m for a, b, m in ((10, 20, 15.0), (4, 8, 6.0)))
    assert rim[0] == pytest.approx(np.sqrt(np.mean(x**2) + np.mean(y**2)), rel=0.02)
    assert middle[1] == pytest.approx((16.5, 16.5))
    assert rim[1] > 0  # of a point too


def test_pictures_have_no_mean_and_unit_length():
    pictures = np.random.default_rng(0).uniform(0, 9, (3, 16, 16)).astype(np.float32)
    pictures[1] = 4.0
    found = normalised(pictures)
    assert found.mean(axis=1) == pytest.approx(0.0, abs=1e-6)
    assert np.linalg.norm(found, axis=1) == pytest.approx([1.0, 0.0, 1.0], abs=1e-5)
    assert normalised(3 * pictures + 7)[0] == pytest.approx(found[0], abs=1e-5)


def test_kinds_do_not_follow_the_gain():
    light = np.zeros((2, SIDE, SIDE), np.float32)
    light[:, 4:12, 5:10] = np.random.default_rng(1).uniform(0.3, 1.0, (2, 8, 5))
    outline = (light > 0).astype(np.float32)
    one, other = kinds_of(light, outline), kinds_of(700 * light, outline)
    assert one.shape == (len(KINDS), 2, SIDE * SIDE)
    assert one == pytest.approx(other, abs=1e-4)
    assert not kinds_of(np.zeros_like(light), np.zeros_like(outline)).any()


def test_edges_are_where_light_changes():
    light = np.zeros((1, SIDE, SIDE), np.float32)
    light[:, :, SIDE // 2 :] = 1.0
    edges = kinds_of(light, light)[KINDS.index("edges")].reshape(SIDE, SIDE)
    assert set(np.argmax(edges, axis=1)) <= {SIDE // 2 - 1, SIDE // 2}
    assert edges[:, : SIDE // 4].max() < edges[:, SIDE // 2 - 1].min()


def test_templates_are_of_one_size_and_in_the_middle():
    """By the moments of what is lit: drawn again, within the draft's roughness."""
    found, drawing = bank(), lit_body()
    assert found.pictures.shape == (len(KINDS), COUNT, SIDE * SIDE)
    view = View((0.0, 0.0), 1.0, SIDE)
    few = found.poses[np.arange(0, COUNT, 10)]
    light = drawing.shaded.pictures(drawing.transforms(few, view), SUN, side=SIDE, supersample=3, shadow_px=128)[:, 0]
    seen = light.max(axis=(1, 2)) > 0.2
    middle, rim = lit_moments(light[seen])
    assert np.median(np.abs(middle - SIDE / 2)) < 0.7
    assert np.median(rim) == pytest.approx(SIDE / 32 * 7.5, rel=0.1)


@pytest.mark.parametrize("k", [3, 77, 180, 301])
@pytest.mark.parametrize(("rim_px", "middle"), [(20.0, (40.0, 55.0)), (38.0, (50.0, 46.0))])
def test_a_templates_own_picture_finds_its_pose(k, rim_px, middle):
    """Moved, at another size, with noise: it is among the very best, at the right place and scale."""
    truth, image = frame(k, rim_px, middle)
    scores, poses = banks.match(bank(), banks.looks(image, SIGMA))
    ranks = [int(np.sum(row > row[k])) for row in scores]
    assert min(ranks) <= 1
    best = int(np.argmin(ranks))
    assert scores[best, k] > 0.85
    assert angle_between(poses[best].quaternion[k], truth.quaternion[0]) < 1e-6
    assert np.abs(poses[best].position[k] - truth.position[0]).max() < 0.15 * rim_px
    assert abs(poses[best].log_scale[k] - truth.log_scale[0]) < 0.15


@pytest.mark.parametrize("off", [0.0, 0.4, 3.0])
def test_a_told_scale_keeps_only_what_agrees_with_it(off):
    """Poses keep to what is told; what disagrees with it is worth less, and still something."""
    truth, image = frame(77, 30.0, (48.0, 48.0))
    seen, wanted = banks.looks(image, SIGMA), float(truth.log_scale[0])
    free, _ = banks.match(bank(), seen)
    scores, poses = banks.match(bank(), seen, wanted + off, 0.02)
    assert (scores <= free + 1e-6).all()
    for one in poses:
        assert np.abs(one.log_scale - wanted - off).max() < 3 * 0.02 + 0.1
    lost = float((free - scores)[:, 77].max())
    assert lost < 0.1 if off == 0 else lost > 0.05 * off
    assert off > 1 or min(int(np.sum(row > row[77])) for row in scores) <= 1


def test_looks_that_agree_with_a_told_scale_are_preferred_to_such_as_are_little_better():
    own = bank().pictures[:, 77]
    for apart, chosen in ((0.5, 1), (0.1, 0), (0.0, 0)):  # the better look's scale is so far off
        told = float(bank().poses.log_scale[77]) + np.log(3.0)
        seen = banks.Looks(np.stack([own, 0.9 * own], axis=1), 3.0 * np.exp([apart, 0.0]), np.array([[0.0, 0], [7, 7]]))
        _, poses = banks.match(bank(), seen, told, 0.02)
        offset = poses[0].position[77] - bank().poses.position[77] * seen.zoom[chosen]
        assert offset == pytest.approx(seen.offset[chosen])


@pytest.mark.parametrize("told", [False, True])
@pytest.mark.parametrize("k", [3, 180, 301])
def test_the_likest_are_compared_in_full_where_principal_pictures_choose_them(k, told):
    """None of the twenty likest is missed among 80 that the principal pictures name; they have the scores of all."""
    truth, image = frame(k, 30.0, (48.0, 48.0))
    seen, scale = banks.looks(image, SIGMA), float(truth.log_scale[0]) if told else None
    scores, poses = banks.match(bank(), seen, scale)
    few, few_poses = banks.match(bank(), seen, scale, kept=80)
    for whole, score, pose, few_pose in zip(scores, few, poses, few_poses, strict=True):
        likest = np.argsort(-whole)[:20]
        assert score[likest] == pytest.approx(whole[likest], abs=1e-5)
        assert few_pose.position[likest] == pytest.approx(pose.position[likest])
        assert np.sqrt(np.mean((score - whole) ** 2)) < 0.05 and (score != whole).any()


def test_each_kind_is_compared_with_its_own_pictures():
    seen = banks.looks(frame(77, 30.0, (48.0, 48.0))[1], SIGMA)
    scores, _ = banks.match(bank(), seen)
    for score, templates, pictures in zip(scores, bank().pictures, seen.pictures, strict=True):
        assert np.array_equal(score, (templates @ pictures.T).max(axis=1))


def test_a_body_darker_than_the_sky_is_matched_by_its_shape():
    _, image = frame(180, 30.0, (48.0, 48.0))
    scores, _ = banks.match(bank(), banks.looks(-image, SIGMA))
    again, _ = banks.match(bank(), banks.looks(image, SIGMA))
    assert scores[:, 180].max() == pytest.approx(again[:, 180].max(), abs=0.05)


@pytest.mark.parametrize("k", [3, 77, 301])
def test_a_body_that_goes_on_where_nothing_is_seen_is_met_at_its_whole_size(k):
    """Two fifths of it beyond an edge: its template is among the likest, where it is; less so as if it ended there."""
    truth, image = frame(k, 30.0, (48.0, 58.0))
    edge = int(np.flatnonzero((image > 20).any(axis=1))[-1] - 0.4 * (image > 20).any(axis=1).sum())
    unseen = np.zeros(image.shape, np.bool_)
    unseen[edge:] = True
    image[unseen] = 0.0
    scores, poses = banks.match(bank(), banks.looks_beyond(image, SIGMA, unseen))
    ranks = [int(np.sum(row > row[k])) for row in scores]
    best = int(np.argmin(ranks))
    assert min(ranks) < 10  # of 400; a kind keeps 80
    assert np.abs(poses[best].position[k] - truth.position[0]).max() < 0.25 * 30.0
    assert abs(poses[best].log_scale[k] - truth.log_scale[0]) < 0.2
    ended, _ = banks.match(bank(), banks.looks(image, SIGMA))
    assert min(int(np.sum(row > row[k])) for row in ended) > min(ranks)


def test_what_does_not_touch_what_is_unseen_ends_where_it_is_seen_to():
    _, image = frame(77, 30.0, (48.0, 48.0))
    unseen = np.zeros(image.shape, np.bool_)
    unseen[:4] = True
    assert not len(banks.looks_beyond(image, SIGMA, unseen).zoom)


def test_a_correlation_over_all_pixels_is_a_product_and_over_some_that_of_their_deviations():
    rng = np.random.default_rng(5)
    templates, pictures = (normalised(rng.normal(size=(n, SIDE, SIDE)).astype(np.float32)) for n in (7, 5))
    known = np.ones_like(pictures)
    assert banks._correlated(templates, pictures, known) == pytest.approx(templates @ pictures.T, abs=1e-5)
    known[:, :150] = 0.0
    wanted = [[np.corrcoef(t[150:], p[150:])[0, 1] for p in pictures] for t in templates]
    assert banks._correlated(templates, pictures, known) == pytest.approx(np.array(wanted), abs=1e-5)


def test_a_patch_without_light_has_looks_that_match_nothing():
    seen = banks.looks(np.zeros((96, 96), np.float32), SIGMA)
    scores, _ = banks.match(bank(), seen)
    assert (scores <= 0).all()
