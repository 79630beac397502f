"""Bodies before clutter: the way from a picture to the body and back, texture's flow, outlines, and a whole track."""

from dataclasses import replace

import numpy as np
import pytest
from cluttered import FIXED, LENS, MESH, SIZE, pose, scene

from gpu.device import find_devices
from gpu.lens import NO_LENS, seen_through
from gpu.reference import silhouette_mask
from service.bench.silhouette import overlap
from service.imaging.clutter import palette_of
from service.inference.articulation import part_transforms
from service.inference.clutter.first import start
from service.inference.clutter.flow import Followed, OnBody, follow, moved
from service.inference.clutter.judging import judged, status_of, told
from service.inference.clutter.settling import Expected, settle
from service.inference.clutter.step import Surroundings, step
from service.inference.domain import Domain
from service.inference.numerics.priors import PosePrior
from service.inference.params import SessionConfig
from service.inference.pose import angle_between, concatenate, retract
from service.inference.state import FilterState, Poses
from service.workers.cluttered_frame import ClutteredFrame, Lifting
from service.workers.codec import decode, encode
from service.workers.lit_body import LitBody

LENSES = [None, LENS]


@pytest.fixture(scope="module")
def body():
    if all(report.rejected for report in find_devices()):
        pytest.skip("no OpenCL device answers")
    opened = LitBody(MESH, FIXED)
    yield opened.body.middle
    opened.close()


@pytest.fixture(scope="module")
def seen():
    return scene(4)


def as_seen(points, part, at, lens):
    """(N, 2) where points of the body at rest are seen: the other way round, by the scorers' own camera."""
    transforms = part_transforms(FIXED, at)[0].astype(float)[part]
    placed = np.einsum("nij,nj->ni", transforms[:, :, :3], points) + transforms[:, :, 3]
    return seen_through(placed, NO_LENS if lens is None else (lens.focal, *lens.middle))[:, :2]


@pytest.mark.parametrize("lens", LENSES)
def test_what_is_lifted_from_a_picture_is_seen_where_it_was(lens):
    rng = np.random.default_rng(1)
    places = rng.uniform(0, SIZE, (400, 2))
    on_body = Lifting(MESH, FIXED, lens)(pose(0), places)
    held = on_body.part >= 0
    assert 60 < held.sum() < 300
    assert np.abs(as_seen(on_body.points[held], on_body.part[held], pose(0), lens) - places[held]).max() < 1e-3
    half = np.array(MESH.size) / 2 + 0.02  # a pixel and a half: faces are those of pixels
    assert (np.abs(on_body.points[held]) <= half).all()
    shape, through = (SIZE, SIZE), None if lens is None else (lens.focal, *lens.middle)
    mask = silhouette_mask(MESH, part_transforms(FIXED, pose(0))[0], shape, through)
    assert np.mean(mask[tuple(places.astype(int).T[::-1])] == held) > 0.97  # but for the rim


@pytest.mark.parametrize("lens", LENSES)
def test_texture_tells_how_a_body_moved_though_a_third_of_the_matches_is_wrong(lens):
    rng = np.random.default_rng(2)
    before, after = pose(0), pose(1.5)
    places = rng.uniform(30, 160, (300, 2))
    on_body = Lifting(MESH, FIXED, lens)(before, places)
    goal = as_seen(on_body.points, np.maximum(on_body.part, 0), after, lens) + rng.normal(0, 0.3, places.shape)
    wrong = rng.random(len(goal)) < 0.33
    goal[wrong] += rng.uniform(-25, 25, (wrong.sum(), 2))
    found = moved(FIXED, before, lens, on_body, Followed(places, goal))
    assert np.rad2deg(angle_between(found.pose.quaternion, after.quaternion))[0] < 0.7
    assert np.abs(found.pose.position - after.position).max() < 0.3
    assert np.linalg.eigvalsh(found.covariance).min() > 0


def test_points_that_are_not_on_the_body_tell_nothing():
    places = np.zeros((40, 2))
    none = OnBody(np.zeros((40, 3)), np.full(40, -1))
    assert moved(FIXED, pose(0), LENS, none, Followed(places, places)) is None


def test_corners_are_found_again_and_flat_pictures_have_none(seen):
    first, second = (frame.mean(axis=2).astype(np.uint8) for frame in seen.frames[:2])
    found = follow(first, second, seen.masks[0], np.zeros(2))
    on_body = Lifting(MESH, FIXED, LENS)(seen.poses[0], found.before)
    held = on_body.part >= 0
    goal = as_seen(on_body.points[held], on_body.part[held], seen.poses[1], LENS)
    assert np.median(np.linalg.norm(goal - found.after[held], axis=1)) < 0.5
    assert follow(np.full_like(first, 9), second, seen.masks[0], np.zeros(2)) is None


def test_an_outline_is_worth_most_where_the_body_is(body, seen):
    frame = ClutteredFrame(seen.frames[0], palette_of(seen.frames[0], seen.box), seen.box, LENS)
    outlook = frame.outlook(body, ((96.0, 96.0), 190.0), 96)
    truth = seen.poses[0]
    steps = np.concatenate([np.diag([0.3, 0.3, 0.3, 9.0, 9.0, 0.15]), -np.diag([0.3, 0.3, 0.3, 9.0, 9.0, 0.15])])
    off = concatenate(*[retract(truth, one[None]) for one in steps])
    assert outlook.score(truth)[0] > outlook.score(off).max() + 3
    ahead = np.array([0.1, 0.8, 0.1])
    here, fit = judged(outlook, truth, ahead)
    assert told(here)[1] > 0.7 and fit.explained > 0.9 and fit.covered_dark < 0.1
    assert judged(outlook, off[:1], ahead)[0][1] < here[1]
    wide = replace(truth, log_scale=truth.log_scale - 1.0)
    assert judged(outlook, wide, ahead)[1].explained < 0.8


def test_an_outline_is_never_told_as_tracking():
    sure = told(np.array([0.0, 1.0, 0.0]))
    assert sure.sum() == pytest.approx(1) and status_of(sure) == "ambiguous"
    assert status_of(told(np.array([0.1, 0.5, 0.4]))) == "no_fit"
    assert status_of(told(np.array([0.95, 0.05, 0.0]))) == "no_target"


def test_draws_find_the_peak_and_spread_of_a_gaussian(body, seen):
    class Flat:
        drawing = body

        def score(self, poses):
            return np.zeros(len(poses))

    goal = seen.poses[1]
    precision = np.diag(np.array([0.02, 0.03, 0.04, 0.8, 0.6, 0.01]) ** -2.0)[None]
    spread = start(body, seen.poses[0], (0.1, 0.03, 0.04, 0.06))
    expected = Expected(goal, precision, FIXED.wrapping)
    found = settle(np.random.default_rng(3), Flat(), seen.poses[0], spread, rounds=12, draws=200, expected=expected)
    assert found.nats[0] > -1
    sigma = np.sqrt(np.diag(found.covariance[0]) * np.diag(precision[0]))
    assert (sigma > 0.5).all() and (sigma < 2).all()


def test_a_followed_body_is_looked_at_where_it_is_and_not_in_the_whole_frame(body, seen):
    large = np.zeros((700, 900, 3), np.uint8)
    large[300 : 300 + SIZE, 400 : 400 + SIZE] = seen.frames[1]
    palette = palette_of(seen.frames[0], seen.box)
    whole = ClutteredFrame(large, palette, None, LENS)
    square = (496.0, 396.0), 120.0
    held = whole.remembered(*whole.picture(square))
    part = ClutteredFrame.of(large, seen.sky.clutter, FilterState(*[None] * 6, clutter=held), LENS)
    assert part.image.shape[0] < 400 and part.corner == (316, 216)
    one, other = (frame.outlook(body, square, 96) for frame in (whole, part))
    assert np.array_equal(one.log_ratio, other.log_ratio) and one.view == other.view
    assert np.allclose(one.slopes, other.slopes)
    inside = np.random.default_rng(0).random((96, 96)).astype(np.float32)
    assert np.array_equal(*(frame.learnt(one.view, inside, 0.5).palette.body for frame in (whole, part)))
    assert np.array_equal(whole.picture(square)[0], part.picture(square)[0])
    gone = replace(held, corner=np.array([-500.0, 4000.0]))
    assert ClutteredFrame.of(large, seen.sky.clutter, FilterState(*[None] * 6, clutter=gone), LENS).image is large


def surroundings(seen, body, state, index):
    frame = ClutteredFrame.of(seen.frames[index], seen.sky.clutter, state, LENS)
    config = SessionConfig()
    domain = Domain(SIZE, SIZE, MESH.radius, FIXED, config.prior, None)
    lift, where = Lifting(MESH, FIXED, LENS), seen.sky.clutter
    return Surroundings(frame, body, where, lift, PosePrior(), config, domain, (), LENS, 5, index, 0.1 * index)


def test_a_body_is_found_in_its_box_and_followed_and_a_restart_changes_nothing(body, seen):
    state, again = None, None
    for index, truth in enumerate(seen.poses):
        rng = np.random.default_rng([7, index])
        state, estimate = step(rng, state, surroundings(seen, body, state, index))
        again = None if again is None else decode(FilterState, encode(again))
        again, other = step(np.random.default_rng([7, index]), again, surroundings(seen, body, again, index))
        assert encode(again) == encode(state) and other.log_evidence == estimate.log_evidence
        best = Poses(
            *(np.atleast_1d(v)[None] for v in (estimate.best.quaternion, estimate.best.position)),
            *(np.log([estimate.best.scale]), np.zeros((1, 0))),
        )
        mask = silhouette_mask(MESH, part_transforms(FIXED, best)[0], (SIZE, SIZE), (LENS.focal, *LENS.middle))
        assert overlap(mask, seen.masks[index]) > 0.9
        apart = [np.rad2deg(angle_between(mode.pose.quaternion[None], truth.quaternion))[0] for mode in estimate.modes]
        assert min(apart) < 8
        assert estimate.status == "ambiguous" and estimate.probabilities[1] > 0.7
