"""The step on the device against the NumPy step: the same numbers where nothing is drawn, the same law where it is."""

import dataclasses

import numpy as np
import pyopencl as cl
import pytest
from gpu_cases import a_map
from scipy import stats
from step_cases import LEAST_P, Case, particles_of, poses_of

import gpu.step
from gpu.errors import ScorerError
from gpu.step import GROUP
from service.inference.articulation import part_transforms
from service.inference.estimate import mean_pose, spread
from service.inference.motion import diffusion
from service.inference.params import FilterParams, MotionParams, SessionConfig
from service.inference.pose import angle_between, local
from service.inference.state import FilterState, Frame, Measurement
from service.inference.step import bootstrap_update
from service.inference.weights import effective_sample_size, normalise

JITTER = np.array([0.05, 0.08, 0.03, 1.5, 2.0, 0.04, 0.02, 5.0])
SIZES = (1, 2, GROUP, 2 * GROUP - 1, 2 * GROUP, 2 * GROUP + 1, 4 * GROUP * GROUP + 77)


@pytest.fixture(scope="module")
def case():
    return Case()


def uploaded(case, poses, log_weights=None):
    count = len(poses)
    return case.step.upload(particles_of(poses, np.full(count, -np.log(count)) if log_weights is None else log_weights))


def fetched(case, buffer, count):
    out = np.empty(count, np.int32)
    cl.enqueue_copy(case.step._queue, out, buffer)
    return out


def drawn(case, log_weights, resampler, seed=1, frame=0):
    particles = uploaded(case, case.prior(len(log_weights)), log_weights)
    return fetched(case, case.step.resample(seed, frame, particles, resampler), len(log_weights))


def middle(case, count, seed=0):
    """Poses that are far from the bounds of everything, so that no step of ``JITTER`` leaves them."""
    poses = case.prior(count, seed)
    low, high = case.domain.log_scale_bounds
    rest = np.tile([0.0, 0.0][: case.domain.articulation.n_joints], (count, 1))
    size = case.domain.width, case.domain.height
    return dataclasses.replace(
        poses, position=np.full((count, 2), 0.5) * size, log_scale=np.full(count, (low + high) / 2), joints=rest
    )


# Resampling (Eq. 6)


@pytest.mark.parametrize("count", SIZES)
@pytest.mark.parametrize("resampler", ["multinomial", "systematic"])
def test_a_particle_of_zero_weight_is_never_drawn(case, count, resampler):
    rng = np.random.default_rng(count)
    log_weights = np.where(rng.random(count) < 0.7, -np.inf, rng.normal(size=count) * 3)
    log_weights[rng.integers(count)] = 0.0
    ancestors = drawn(case, log_weights, resampler)
    assert ancestors.min() >= 0
    assert ancestors.max() < count
    assert np.isfinite(log_weights[ancestors]).all()


def test_equal_weights_resampled_systematically_draw_each_once(case):
    for count in SIZES:
        assert np.array_equal(drawn(case, np.zeros(count), "systematic"), np.arange(count))


def test_systematic_counts_are_within_one_of_what_is_expected(case):
    log_weights = np.random.default_rng(1).normal(size=5001) * 2
    counts = np.bincount(drawn(case, log_weights, "systematic"), minlength=5001)
    expected = 5001 * np.exp(normalise(log_weights)[0])
    assert (np.abs(counts - expected) < 1 + 1e-3).all()


@pytest.mark.parametrize("resampler", ["multinomial", "systematic"])
def test_a_particle_is_drawn_as_often_as_its_weight_says(case, resampler):
    log_weights = np.random.default_rng(2).normal(size=50)
    expected = np.exp(normalise(log_weights)[0])
    counts = sum(np.bincount(drawn(case, log_weights, resampler, frame=f), minlength=50) for f in range(200))
    if resampler == "multinomial":
        assert stats.chisquare(counts, expected * counts.sum()).pvalue > LEAST_P
    else:
        assert np.allclose(counts / counts.sum(), expected, atol=3e-3)


def test_multinomial_draws_are_uniform_in_cumulative_weight(case):
    ancestors = drawn(case, np.zeros(100_003), "multinomial")
    assert stats.kstest((ancestors + 0.5) / 100_003, "uniform").pvalue > LEAST_P
    assert np.abs(np.corrcoef(ancestors[:-1], ancestors[1:])[0, 1]) < 5 / np.sqrt(100_003)


def test_one_heavy_particle_among_many_light_ones_has_its_share(case):
    log_weights = np.full(200_001, -np.log(200_000.0))
    log_weights[123_456] = 0.0
    share = np.mean(drawn(case, log_weights, "multinomial") == 123_456)
    assert abs(share - 0.5) < 5 * 0.5 / np.sqrt(200_001)


# Motion


def test_jitter_is_gaussian_in_the_tangent_space(case):
    poses = middle(case, 20_000)
    particles = uploaded(case, poses)
    ancestors = case.step.resample(1, 0, particles, "systematic")
    moved = poses_of(case.step.download(case.step.move(1, 0, particles, ancestors, JITTER)))
    steps = local(poses, moved) / JITTER
    assert all(stats.kstest(column, "norm").pvalue > LEAST_P for column in steps.T)
    assert np.abs(np.corrcoef(steps.T) - np.eye(8)).max() < 5 / np.sqrt(len(steps))


def test_a_step_out_of_the_bounds_is_not_made_and_a_full_turn_wraps(case):
    poses = case.prior(5000)
    particles = uploaded(case, poses)
    ancestors = case.step.resample(1, 0, particles, "systematic")
    wide = np.array([0.5, 0.5, 0.5, 40, 40, 0.5, 0.2, 300.0])
    moved = poses_of(case.step.download(case.step.move(1, 0, particles, ancestors, wide)))
    assert case.domain.contains(moved).all()
    assert (moved.joints[:, 1] >= -180).all()
    assert (moved.joints[:, 1] <= 180).all()
    stayed = np.all(np.abs(moved.position - poses.position) < 1e-4, axis=1)
    assert 0.2 < stayed.mean() < 0.8
    assert np.rad2deg(angle_between(moved.quaternion[stayed], poses.quaternion[stayed])).max() < 1e-4


@pytest.mark.parametrize("free", [("boom", "panel"), ("panel",), ()])
def test_part_transforms_are_those_of_the_filter(free):
    case = Case(free)
    poses = case.prior(301)
    out = np.empty((300, 3, 3, 4), np.float32)
    cl.enqueue_copy(case.step._queue, out, case.step.part_transforms(uploaded(case, poses), 1, 300))
    expected = part_transforms(case.domain.articulation, poses[1:])
    assert np.abs(out - expected).max() < 1e-4


# Weights and moments (Eq. 5)


@pytest.mark.parametrize("count", [1, 255, 1000, 40_001])
@pytest.mark.parametrize("free", [("boom", "panel"), ()])
def test_weights_and_moments_are_those_of_numpy(count, free):
    case = Case(free)
    rng = np.random.default_rng(count)
    n_tangent = case.domain.n_tangent
    middles = uploaded(case, middle(case, 1)[np.zeros(count, int)])
    ancestors = case.step.resample(7, 3, middles, "systematic")
    cloud = case.step.move(7, 3, middles, ancestors, 2 * JITTER[:n_tangent])
    values = a_map(rng)
    weighed, summary = case.step.weigh(cloud, values, exponent=0.02)

    result = case.step.download(weighed)
    poses = poses_of(result)
    log_likelihood = case.scorer.score(part_transforms(case.domain.articulation, poses), values)
    log_weights, total = normalise(0.02 * log_likelihood)
    wrapping = case.domain.wrapping
    weights = np.exp(result.log_weights)
    mean = mean_pose(poses, weights / weights.sum(), wrapping)
    about = spread(poses, weights / weights.sum(), mean, wrapping)
    covariance = about.covariance.copy()
    covariance[:3] = np.deg2rad(covariance[:3])
    covariance[:, :3] = np.deg2rad(covariance[:, :3])
    deviation = np.sqrt(np.maximum(np.diag(covariance), 1e-6))

    assert np.abs(result.log_weights - log_weights).max() < 0.1  # a score may differ by a pixel of the outline
    assert np.median(np.abs(result.log_weights - log_weights)) < 1e-3
    assert summary.ess == pytest.approx(effective_sample_size(result.log_weights), rel=1e-4)
    assert summary.log_evidence == pytest.approx(total - np.log(count), abs=2e-3)
    assert summary.best_log_likelihood == pytest.approx(log_likelihood.max(), rel=1e-2)
    assert log_likelihood[summary.best] == pytest.approx(log_likelihood.max(), rel=1e-2)
    assert np.rad2deg(angle_between(summary.quaternion, mean.quaternion[0])) < 1e-3
    assert np.allclose(summary.position, mean.position[0], atol=1e-3)
    assert np.isclose(summary.scale, np.exp(mean.log_scale[0]), rtol=1e-5)
    assert np.allclose(summary.joints, mean.joints[0], atol=1e-3)
    assert np.abs((summary.covariance - covariance) / np.outer(deviation, deviation)).max() < 1e-2
    assert summary.scale_deviation == pytest.approx(about.scale_px, rel=1e-3, abs=1e-4)


def test_batches_of_transforms_change_nothing(case, monkeypatch):
    values = a_map(np.random.default_rng(3))
    particles = uploaded(case, case.prior(1000))
    whole = case.step.weigh(particles, values, 0.05)
    monkeypatch.setattr(gpu.step, "TRANSFORMS_BYTES", 48 * 3 * 77)
    parted = case.step.weigh(particles, values, 0.05)
    assert np.array_equal(case.step.download(whole[0]).log_weights, case.step.download(parted[0]).log_weights)


# The whole step


@pytest.mark.parametrize("resampler", ["multinomial", "systematic"])
def test_a_step_has_the_law_of_the_numpy_step(case, resampler):
    count, exponent, values = 20_000, 0.004, a_map(np.random.default_rng(4))
    motion = MotionParams(kind="jitter", rotation_deg=10.0, joint_deg=20.0)
    config = SessionConfig(
        FilterParams(method="bootstrap", particles=count, resampler=resampler),
        motion=motion,
    )
    start = case.prior(count)
    log_weights, _ = normalise(np.random.default_rng(5).normal(size=count))
    state = FilterState(start, log_weights, np.zeros((count, 8)), 0, 0.0, "tracking")
    frame = Frame(1, 1.0, Measurement(values, 0.0))

    def score(poses):
        return exponent * case.scorer.score(part_transforms(case.domain.articulation, poses), values)

    host = bootstrap_update(np.random.default_rng(6), state, frame, score, config, case.domain)
    jitter = diffusion(motion, case.domain)
    moved, summary = case.step.run(6, 1, uploaded(case, start, log_weights), values, jitter, resampler, exponent)
    device = case.step.download(moved)

    for ours, theirs in zip(marginals(poses_of(device)), marginals(host.poses), strict=True):
        assert stats.ks_2samp(ours, theirs).pvalue > LEAST_P
    ours, theirs = device.log_weights + summary.log_evidence, host.log_weights + host.log_evidence
    assert stats.ks_2samp(ours, theirs).pvalue > LEAST_P
    ess = effective_sample_size(host.log_weights)
    assert summary.log_evidence == pytest.approx(host.log_evidence, abs=3 * np.sqrt(2 / ess))
    assert summary.ess == pytest.approx(ess, rel=0.2)


def marginals(poses):
    """Every coordinate, and products of them that a wrong correlation would change."""
    q = poses.quaternion * np.where(poses.quaternion[:, :1] < 0, -1, 1)
    singles = [*q.T, *poses.position.T, poses.log_scale, *poses.joints.T]
    return [*singles, poses.position[:, 0] * poses.log_scale, q[:, 1] * poses.joints[:, 1]]


def test_same_seed_same_bits_other_seed_or_frame_other_bits(case):
    values = a_map(np.random.default_rng(8))
    particles = uploaded(case, case.prior(777))

    def after(seed, frame):
        return case.step.download(case.step.run(seed, frame, particles, values, JITTER, "multinomial", 0.05)[0])

    first, again = after(2**62 + 5, 9), after(2**62 + 5, 9)
    for field in dataclasses.fields(first):
        assert np.array_equal(getattr(first, field.name), getattr(again, field.name))
    for seed, frame in ((2**62 + 6, 9), (5, 9), (2**62 + 5, 10)):
        assert not np.array_equal(after(seed, frame).position, first.position)


def test_particles_come_back_as_they_went(case):
    poses = case.prior(33)
    log_weights, _ = normalise(np.random.default_rng(9).normal(size=33) - 1e4)
    back = case.step.download(uploaded(case, poses, log_weights))
    assert np.allclose(back.quaternion, poses.quaternion, atol=1e-6)
    assert np.allclose(back.position, poses.position, atol=1e-4)
    assert np.allclose(back.joints, poses.joints, atol=1e-4)
    assert np.allclose(back.log_weights, log_weights, atol=1e-5)


@pytest.mark.parametrize("bad", [-np.inf, np.nan, np.inf])
def test_weights_that_are_none_are_refused(case, bad):
    with pytest.raises(ScorerError, match="positive weight"):
        uploaded(case, case.prior(4), np.full(4, bad))


def test_a_pose_that_is_not_finite_is_refused(case):
    poses = case.prior(4)
    poses.position[2, 1] = np.nan
    with pytest.raises(ScorerError, match="not finite"):
        uploaded(case, poses)


@pytest.mark.parametrize(("seed", "frame"), [(-1, 0), (2**64, 0), (0, -1), (0, 2**32)])
def test_a_seed_that_does_not_fit_is_refused(case, seed, frame):
    with pytest.raises(ValueError, match="does not fit"):
        case.step.resample(seed, frame, uploaded(case, case.prior(2)), "systematic")


def test_what_the_step_cannot_take_is_refused(case):
    particles = uploaded(case, case.prior(2))
    with pytest.raises(ScorerError, match="residual"):
        case.step.resample(0, 0, particles, "residual")
    with pytest.raises(ScorerError, match=r"not \(8,\)"):
        case.step.move(0, 0, particles, case.step.resample(0, 0, particles, "systematic"), JITTER[:7])
    with pytest.raises(ScorerError, match=r"not \(N, 2\)"):
        uploaded(case, dataclasses.replace(case.prior(2), joints=np.zeros((2, 1))))
