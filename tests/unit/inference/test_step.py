"""One update on a small picture of a block: the paper's three verbs, determinism, and that it is found."""

import dataclasses

import numpy as np
import pytest

from gpu.reference import silhouette_mask
from service.inference.articulation import part_transforms
from service.inference.domain import Domain, sample_prior
from service.inference.motion import diffusion
from service.inference.params import FilterParams, MotionParams, PriorParams, SessionConfig
from service.inference.pose import exp_so3, multiply
from service.inference.state import FilterState, Frame, Measurement, Poses
from service.inference.step import bootstrap_update, step

WIDTH, HEIGHT = 36, 30
TRUTH = Poses(exp_so3(np.array([[0.3, -0.2, 0.5]])), np.array([[17.0, 14.0]]), np.log([9.0]), np.zeros((1, 0)))


def config(particles: int = 40, jitter: float = 1.0) -> SessionConfig:
    return SessionConfig(
        filter=FilterParams("paper", "bootstrap", particles, 3, "multinomial"),
        motion=MotionParams("jitter", rotation_deg=10 * jitter, position=0.03 * jitter, log_scale=0.05 * jitter),
    )


@pytest.fixture(scope="module")
def domain(block, rigid) -> Domain:
    return Domain(WIDTH, HEIGHT, block.radius, rigid, PriorParams(0.3, 1.0))


@pytest.fixture(scope="module")
def log_ratio(block, rigid) -> np.ndarray:
    """A map in favour of the block at TRUTH: +2 on it, -1 around."""
    mask = silhouette_mask(block, part_transforms(rigid, TRUTH)[0], (HEIGHT, WIDTH))
    return np.where(mask, 2.0, -1.0).astype(np.float32)


def philox(index: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(key=np.array([3, index], np.uint64)))


def frame(log_ratio: np.ndarray, index: int, dt_s: float = 1.0) -> Frame:
    return Frame(index, index * dt_s, Measurement(log_ratio, -100.0))


def test_the_first_frame_weighs_the_prior(domain, log_ratio, score_of):
    score = score_of(0.1 * log_ratio)
    outcome = bootstrap_update(philox(0), None, frame(log_ratio, 0), score, config(), domain)
    prior = sample_prior(philox(0), domain, 40)
    np.testing.assert_array_equal(outcome.poses.quaternion, prior.quaternion)
    likelihood = np.exp(score(prior))
    np.testing.assert_allclose(np.exp(outcome.log_weights), likelihood / likelihood.sum())
    np.testing.assert_allclose(outcome.log_evidence, np.log(likelihood.mean()))


def test_an_update_resamples_jitters_and_weighs(domain, log_ratio, score_of):
    """The three verbs of the paper, written out with the same random numbers."""
    score = score_of(0.05 * log_ratio)
    first = bootstrap_update(philox(0), None, frame(log_ratio, 0), score, config(), domain)
    state = FilterState(first.poses, first.log_weights, first.rates, 0, 0.0, first.status)
    found = bootstrap_update(philox(1), state, frame(log_ratio, 1, 0.25), score, config(), domain)

    rng = philox(1)
    cumulative = np.cumsum(np.exp(state.log_weights))
    r = (1.0 - rng.random(40)) * cumulative[-1]
    ancestors = [next(j for j in range(40) if cumulative[j] >= r_i * (1 - 1e-15)) for r_i in r]
    before = state.poses[np.array(ancestors)]
    jitter = rng.standard_normal((40, 6)) * np.array([np.deg2rad(10)] * 3 + [0.9, 0.9, 0.05]) * np.sqrt(0.25)
    rotation = multiply(before.quaternion, exp_so3(jitter[:, :3]))
    position, log_scale = before.position + jitter[:, 3:5], before.log_scale + jitter[:, 5]
    moved = Poses(rotation, position, log_scale, before.joints)
    stays = ~domain.contains(moved)
    expected = Poses(
        np.where(stays[:, None], before.quaternion, rotation),
        np.where(stays[:, None], before.position, position),
        np.where(stays, before.log_scale, log_scale),
        before.joints,
    )
    for name in ("quaternion", "position", "log_scale"):
        np.testing.assert_allclose(getattr(found.poses, name), getattr(expected, name), rtol=1e-12)
    weights = np.exp(score(expected))
    np.testing.assert_allclose(np.exp(found.log_weights), weights / weights.sum(), rtol=1e-9)
    np.testing.assert_allclose(found.log_likelihood, score(expected))


def test_particles_stay_within_the_prior(domain, log_ratio, score_of):
    """Jitter that would leave the bounds is not made, however wild."""

    def flat(poses: Poses) -> np.ndarray:
        return np.zeros(len(poses))

    state = None
    for index in range(5):
        outcome = bootstrap_update(philox(index), state, frame(log_ratio, index), flat, config(jitter=20), domain)
        assert domain.contains(outcome.poses).all()
        state = FilterState(outcome.poses, outcome.log_weights, outcome.rates, index, index * 1.0, outcome.status)


def test_the_deviation_of_the_jitter_by_hand(domain):
    """10 degrees, 3 % of 30 px, 5 % of the scale."""
    np.testing.assert_allclose(diffusion(config().motion, domain), [np.deg2rad(10)] * 3 + [0.9, 0.9, 0.05])


def test_the_paper_filter_closes_in_on_the_block(domain, log_ratio, score_of):
    state, scores = None, []
    settings, score = config(particles=120, jitter=0.5), score_of(0.03 * log_ratio)
    for index in range(12):
        state, estimate = step(philox(index), state, frame(log_ratio, index), score, settings, domain)
        scores.append(estimate.best_log_likelihood + 100.0)  # less the frame's constant
    perfect = float(np.maximum(0.03 * log_ratio, 0).sum())
    assert scores[-1] > 0.8 * perfect
    assert scores[-1] > scores[0]
    assert np.linalg.norm(estimate.mean.position - TRUTH.position[0]) < 3.0  # a tenth of the image; 120 particles
    assert estimate.status == "tracking"
    assert 1 <= estimate.ess <= 120


def test_nothing_there_is_no_target(domain, score_of):
    empty = np.full((HEIGHT, WIDTH), -1.0, np.float32)
    _, estimate = step(philox(0), None, frame(empty, 0), score_of(empty), config(), domain)
    assert estimate.status == "no_target"


def test_the_same_key_gives_the_same_answer_and_the_state_is_left_alone(domain, log_ratio, score_of):
    first, _ = step(philox(0), None, frame(log_ratio, 0), score_of(log_ratio), config(), domain)
    before = snapshot(first)
    runs = [step(philox(1), first, frame(log_ratio, 1), score_of(log_ratio), config(), domain) for _ in range(2)]
    assert snapshot(first) == before
    assert snapshot(runs[0][0]) == snapshot(runs[1][0])
    assert snapshot(runs[0][1]) == snapshot(runs[1][1])
    other, _ = step(philox(2), first, frame(log_ratio, 1), score_of(log_ratio), config(), domain)
    assert snapshot(other) != snapshot(runs[0][0])


def test_a_state_cannot_be_changed(domain, log_ratio, score_of):
    state, _ = step(philox(0), None, frame(log_ratio, 0), score_of(log_ratio), config(), domain)
    with pytest.raises(dataclasses.FrozenInstanceError):
        state.status = "lost"


def snapshot(value) -> object:
    """Everything in a state or an estimate, bit for bit."""
    if dataclasses.is_dataclass(value):
        return [snapshot(getattr(value, field.name)) for field in dataclasses.fields(value)]
    if isinstance(value, dict):
        return {key: snapshot(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray):
        return (value.dtype.str, value.shape, value.tobytes())
    if isinstance(value, (tuple, list)):
        return [snapshot(entry) for entry in value]
    return value
