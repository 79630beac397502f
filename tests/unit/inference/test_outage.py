"""A turning block that goes out of sight and comes back, at uneven times: statuses, widening, return, determinism."""

import itertools
from dataclasses import dataclass

import numpy as np
import pytest

from service.inference.articulation import Articulation, Joint, Stage
from service.inference.domain import Domain
from service.inference.params import FilterParams, LikelihoodParams, PriorParams, SessionConfig
from service.inference.pose import angle_between, exp_so3, multiply
from service.inference.state import Estimate, FilterState, Frame, Measurement, Poses
from service.inference.step import one_of_twins, step
from service.inference.symmetry import Symmetry
from service.inference.tracking import track, unseen
from service.inference.update import Update

WIDTH, HEIGHT = 40, 34
SIGNS = [signs for signs in itertools.product((1.0, -1.0), repeat=3) if signs != (1.0, 1.0, 1.0)]
TWINS = tuple(Symmetry(((a, 0, 0), (0, b, 0), (0, 0, c))) for a, b, c in SIGNS)  # of a brick
EMPTY = np.full((HEIGHT, WIDTH), -1.0, np.float32)
BEFORE, BLANK, AFTER = 6, 8, 4


@dataclass(frozen=True)
class Told:
    """A frame: where the block is, and what the filter said."""

    truth: Poses
    perfect: float  # the best log likelihood that a silhouette can have
    state: FilterState
    estimate: Estimate


@pytest.fixture(scope="module")
def domain(block, rigid) -> Domain:
    return Domain(WIDTH, HEIGHT, block.radius, rigid, PriorParams(0.3, 1.0))


def block_at(time_s: float) -> Poses:
    """12 degrees a second, drifting 2 px a second."""
    rotation = multiply(exp_so3(np.array([[0.9, -0.6, 0.5]])), exp_so3(time_s * np.array([[0.0, 0.17, 0.12]])))
    return Poses(rotation, np.array([[17.0 + 2 * time_s, 18.0 - time_s]]), np.log([9.0]), np.zeros((1, 0)))


@pytest.fixture(scope="module")
def picture(quick_score_maps):
    """(H, W) map in favour of a pose: +3 on its silhouette, -1 around. One map per pixel shows the silhouette."""
    pixels = np.eye(HEIGHT * WIDTH, dtype=np.float32).reshape(-1, HEIGHT, WIDTH)

    def draw(pose: Poses) -> np.ndarray:
        covered = quick_score_maps(pose, pixels)[0].reshape(HEIGHT, WIDTH) > 0.5
        return np.where(covered, 3.0, -1.0).astype(np.float32)

    return draw


@pytest.fixture(scope="module")
def run(picture, quick_score_maps, domain):
    """``run(method, times, blank)``: one frame per time, those of the indices ``blank`` empty."""

    def track(method: str, times: list[float], blank: range, seed: int = 5) -> list[Told]:
        settings = SessionConfig(
            filter=FilterParams(method=method, particles=200, acquisition_particles=800),
            likelihood=LikelihoodParams(exponent=0.05),
        )
        state, told = None, []
        for index, time_s in enumerate(times):
            truth = block_at(time_s)
            shown = EMPTY if index in blank else picture(truth)
            rng = np.random.Generator(np.random.Philox(key=np.array([seed, index], np.uint64)))
            now = Frame(index, time_s, Measurement(shown, 0.0))
            state, estimate = step(rng, state, now, quick_score_maps, settings, domain, TWINS)
            told.append(Told(truth, float(np.maximum(shown, 0).sum()), state, estimate))
        return told

    return track


def uneven(count: int) -> list[float]:
    """Times whose steps are 0.05 to 0.2 s."""
    return [float(t) for t in np.cumsum(np.tile([0.1, 0.05, 0.2, 0.1], count))[:count]]


@pytest.fixture(scope="module")
def outage(run) -> list[Told]:
    return list(run("importance", uneven(BEFORE + BLANK + AFTER), range(BEFORE, BEFORE + BLANK)))


def off_deg(told: Told) -> float:
    """Angle of the nearest mode from the truth: in so few pixels a brick looks much the same from several sides."""
    modes = [mode.pose.quaternion for mode in told.estimate.modes]
    return float(np.rad2deg(np.min(angle_between(np.array(modes), told.truth.quaternion))))


def side_of(state: FilterState, domain: Domain) -> FilterState:
    folded = one_of_twins(state, TWINS, domain)
    assert folded is not None
    return folded


def position_deviation(state: FilterState) -> float:
    weights = np.exp(state.log_weights)
    mean = weights @ state.poses.position
    return float(np.sqrt(np.sum(weights @ (state.poses.position - mean) ** 2)))


def test_every_frame_has_the_status_of_what_it_shows(outage):
    statuses = [told.estimate.status for told in outage]
    assert statuses[:BEFORE] == ["acquiring", "acquiring", *["tracking"] * (BEFORE - 2)]
    assert statuses[BEFORE : BEFORE + BLANK] == ["no_target"] * BLANK
    assert set(statuses[BEFORE + BLANK :]) <= {"acquiring", "tracking"}
    assert statuses[-1] == "tracking"


def test_the_block_is_followed_before_and_found_within_three_frames_after(outage):
    for told in [*outage[1:BEFORE], *outage[BEFORE + BLANK + 2 :]]:
        assert told.estimate.best_log_likelihood > 0.9 * told.perfect
        assert np.linalg.norm(told.estimate.best.position - told.truth.position[0]) < 1.0
        assert off_deg(told) < 15  # a block of 30 px: its outline says no more


def test_the_prediction_keeps_widening_while_nothing_is_seen(outage, domain):
    """Frame after frame, both where the block may be and how it may be turned."""
    blank = outage[BEFORE : BEFORE + BLANK]
    widths = [position_deviation(told.state) for told in blank]
    assert widths[0] > position_deviation(outage[BEFORE - 1].state)
    assert np.all(np.diff(widths) > 0)
    turns = []
    for told in blank:
        folded = side_of(told.state, domain)
        weights = np.exp(folded.log_weights)
        centre = folded.poses.quaternion[int(np.argmax(weights))]
        turns.append(float(np.sqrt(weights @ angle_between(folded.poses.quaternion, centre) ** 2)))
    assert turns[-1] > turns[0]
    for told in blank:
        assert np.exp(told.state.log_weights).sum() == pytest.approx(1)
        assert told.state.time_s > 0


def test_a_gap_without_frames_is_crossed_too(run):
    """A second and a half without any frame: 18 degrees of turn later the block is found, by the third frame."""
    times = [0.1 * k for k in range(6)] + [2.0 + 0.1 * k for k in range(3)]
    last = [run("importance", times, range(0), seed)[-1] for seed in range(5)]
    assert all(told.estimate.status in ("acquiring", "tracking") for told in last)
    assert all(told.estimate.best_log_likelihood > 0.9 * told.perfect for told in last)
    assert np.median([off_deg(told) for told in last]) < 15


def test_a_pass_that_begins_with_empty_frames(run):
    """Nothing is known, nothing is seen: a covering of the whole space; then the block is acquired at once."""
    told = run("importance", [0.1 * k for k in range(5)], range(2))
    assert [t.estimate.status for t in told] == ["no_target", "no_target", "acquiring", "acquiring", "tracking"]
    assert told[2].estimate.best_log_likelihood > 0.9 * told[2].perfect


def test_the_same_frames_give_the_same_bits(run, outage):
    """Acquisition, following, blank frames and return; everything that a state holds."""
    times = uneven(BEFORE + BLANK + AFTER)
    for a, b in zip(outage, run("importance", times, range(BEFORE, BEFORE + BLANK)), strict=True):
        assert bits(a.state) == bits(b.state)
        assert a.estimate.log_evidence == b.estimate.log_evidence
        assert a.estimate.best.quaternion.tobytes() == b.estimate.best.quaternion.tobytes()
    other = run("importance", times[:1], range(0), seed=6)
    assert bits(other[0].state) != bits(outage[0].state)


def test_the_paper_s_method_gives_the_same_bits_too(run):
    first, second = (run("bootstrap", uneven(4), range(2, 3)) for _ in range(2))
    for a, b in zip(first, second, strict=True):
        assert bits(a.state) == bits(b.state)


def bits(state: FilterState) -> list[bytes]:
    poses = state.poses
    arrays = [poses.quaternion, poses.position, poses.log_scale, poses.joints, state.log_weights, state.rates]
    return [np.asarray(a).tobytes() for a in [*arrays, *(state.memory[name] for name in sorted(state.memory))]]


def test_a_joint_out_of_sight_stays_within_its_bounds():
    """A boom that was being driven out, unseen for a minute, is at most all the way out."""
    boom = Joint("boom", "prismatic", 0.0, 2.0, 0.0, (Stage("prismatic", ("boom",), (0, 0, 1)),))
    domain = Domain(WIDTH, HEIGHT, 1.0, Articulation(("bus", "boom"), (boom,)), PriorParams(0.3, 1.0))
    poses = Poses(np.tile([1.0, 0, 0, 0], (50, 1)), np.full((50, 2), 18.0), np.full(50, 2.0), np.full((50, 1), 1.5))
    rates = np.tile([0, 0, 0, 0, 0, 0, 0.5], (50, 1))
    memory = {"age": np.array(5.0)}
    state = FilterState(poses, np.full(50, -np.log(50)), rates, 0, 0.0, "tracking", memory)
    rng = np.random.Generator(np.random.Philox(7))
    blank = Frame(1, 60.0, Measurement(EMPTY, 0.0))
    update = Update(rng, state, blank, lambda p, maps: np.full((len(p), 1), -1.0), SessionConfig(), domain, ())
    joints = unseen(update).poses.joints
    assert joints.min() >= 0.0
    assert joints.max() == 2.0


@pytest.mark.parametrize(("gain", "status"), [(900.0, "tracking"), (5_000.0, "no_target")])
def test_a_star_is_not_what_a_bright_track_has_become(gain, status):
    """A sliver of the object may cover it: 20 nats are the object only where that is not next to nothing of its usual
    gain on the empty sky."""
    domain = Domain(WIDTH, HEIGHT, 1.0, Articulation(("bus",)), PriorParams(0.3, 1.0))
    poses = Poses(np.tile([1.0, 0, 0, 0], (50, 1)), np.full((50, 2), 18.0), np.full(50, 2.0), np.zeros((50, 0)))
    memory = {"age": np.array(5.0), "gain": np.array(gain), "support": np.array(0.9)}
    state = FilterState(poses, np.full(50, -np.log(50)), np.zeros((50, 6)), 4, 0.4, "tracking", memory)
    star = EMPTY.copy()
    star[10:12, 10:14] = 3.0
    rng = np.random.Generator(np.random.Philox(7))
    frame = Frame(5, 0.5, Measurement(star, 0.0))
    outcome = track(rng, state, frame, lambda p, maps: np.full((len(p), 1), 20.0), SessionConfig(), domain)
    assert outcome.status == status
    assert float(outcome.memory["gain"]) == pytest.approx(gain if status == "no_target" else 0.85 * gain + 0.15 * 20.0)
