"""Frame to frame against a Kalman filter: poses, rates and gaps in time, where everything is Gaussian.

Each tangent coordinate alone: state (x, v), x' = x + v dt, process noise q dt + r dt^3 / 3 on x and r dt on v,
likelihood exp(-(x - y)^2 / (2 s^2)). Rotations are small, so that the space is flat.
"""

from dataclasses import replace

import numpy as np
import pytest

from service.inference.articulation import Articulation, Joint, Stage
from service.inference.domain import Domain
from service.inference.motion import motion_noise
from service.inference.params import FilterParams, LikelihoodParams, MotionParams, PriorParams, SessionConfig
from service.inference.pose import local, retract
from service.inference.state import FilterState, Frame, Measurement, Poses
from service.inference.tracking import follow, predicted_components, unseen
from service.inference.update import Update
from service.inference.weights import normalise

D = 7
BOOM = Joint("boom", "prismatic", -1000, 1000, 0.0, (Stage("prismatic", ("boom",), (0, 0, 1)),))
DOMAIN = Domain(400, 400, 1.0, Articulation(("bus", "boom"), (BOOM,)), PriorParams(0.001, 10.0))
MOTION = MotionParams(rotation_deg=0.5, position=0.005, rate_spread=4.0, joint_range=0.002)
ORIGIN = Poses(np.array([[0.5, -0.5, 0.5, 0.5]]), np.array([[200.0, 200.0]]), np.array([1.0]), np.array([[0.0]]))
NOTHING_TOLD = Measurement(np.zeros((2, 2), np.float32), 0.0)
COUNT = 4000
FILTER = motion_noise(MOTION, DOMAIN)
Q, R, V0 = FILTER.jitter, FILTER.change, FILTER.variance
X0 = 0.3 * np.sqrt(Q)  # deviation of the first posterior
SEEN = 0.4 * np.sqrt(Q)  # of a frame's measurement


def philox(*key: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(key=np.array(key, np.uint64)))


def config(**options) -> SessionConfig:
    return SessionConfig(
        filter=FilterParams(particles=COUNT, **options), likelihood=LikelihoodParams(exponent=1.0), motion=MOTION
    )


def start(rng: np.random.Generator, rate: np.ndarray) -> FilterState:
    """Poses about the origin, rates of variance V0 about ``rate``: what is left to differ is what the filter does."""
    z = rng.standard_normal((COUNT, 2 * D))
    z = z - z.mean(axis=0)
    z = z @ np.linalg.inv(np.linalg.cholesky(np.cov(z.T, ddof=0))).T  # moments exact
    poses = retract(Poses(*(np.repeat(a, COUNT, axis=0) for a in vars(ORIGIN).values())), z[:, :D] * X0)
    rates = rate + z[:, D:] * np.sqrt(V0)
    memory = {"age": np.array(5.0)}
    return FilterState(poses, np.full(COUNT, -np.log(COUNT)), rates, 0, 0.0, "tracking", memory)


def update_of(state: FilterState, time_s: float, seen: np.ndarray | None, index: int = 1) -> Update:
    def score_maps(poses: Poses, maps: np.ndarray) -> np.ndarray:
        if seen is None:
            return np.full((len(poses), 1), -1.0)
        z = (local(ORIGIN, poses) - seen) / SEEN
        return -0.5 * np.sum(z * z, axis=1)[:, None]

    frame = Frame(index, time_s, NOTHING_TOLD)
    return Update(philox(9, index), state, frame, score_maps, config(), DOMAIN, ())


def moments(poses: Poses, rates: np.ndarray, log_weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(14,) mean and (14, 14) covariance of (pose, rate), in units of sqrt(q) and sqrt(r)."""
    z = np.hstack([local(ORIGIN, poses) / np.sqrt(Q), rates / np.sqrt(R)])
    weights = np.exp(normalise(log_weights)[0])
    mean = weights @ z
    return mean, np.einsum("n,ni,nj->ij", weights, z - mean, z - mean)


class Kalman:
    """(7, 2) means and (7, 2, 2) covariances of (x, v), coordinate by coordinate."""

    def __init__(self, rate: np.ndarray) -> None:
        self.mean = np.stack([np.zeros(D), rate], axis=1)
        self.covariance = np.zeros((D, 2, 2))
        self.covariance[:, 0, 0], self.covariance[:, 1, 1] = X0**2, V0

    def predict(self, dt_s: float) -> None:
        carry = np.array([[1, dt_s], [0, 1]])
        self.mean = self.mean @ carry.T
        self.covariance = carry @ self.covariance @ carry.T
        self.covariance[:, 0, 0] += Q * dt_s + R * dt_s**3 / 3
        self.covariance[:, 0, 1] += R * dt_s**2 / 2
        self.covariance[:, 1, 0] += R * dt_s**2 / 2
        self.covariance[:, 1, 1] += R * dt_s

    def see(self, y: np.ndarray) -> None:
        gain = self.covariance[:, :, 0] / (self.covariance[:, 0, 0] + SEEN**2)[:, None]
        self.mean = self.mean + gain * (y - self.mean[:, 0])[:, None]
        self.covariance = self.covariance - gain[:, :, None] * self.covariance[:, :1, :]

    def check(self, poses: Poses, rates: np.ndarray, log_weights: np.ndarray, tolerance: float) -> None:
        mean, covariance = moments(poses, rates, log_weights)
        for k in range(D):
            unit = np.sqrt(np.array([Q[k], R[k]]))
            deviation = np.sqrt(np.diag(self.covariance[k])) / unit
            pair = [k, k + D]
            np.testing.assert_allclose((mean[pair] - self.mean[k] / unit) / deviation, 0, atol=tolerance)
            found = covariance[np.ix_(pair, pair)] / np.outer(deviation, deviation)
            expected = self.covariance[k] / np.outer(unit, unit) / np.outer(deviation, deviation)
            np.testing.assert_allclose(found, expected, atol=2 * tolerance)


def test_poses_and_rates_are_a_kalman_filters_over_several_frames():
    """Eight frames at uneven times, measurements along a steady motion with noise: sampling is all that differs."""
    rng = philox(1, 2)
    rate = 2.0 * np.sqrt(V0) * rng.standard_normal(D) / 2
    state, kalman, then = start(rng, np.zeros(D)), Kalman(np.zeros(D)), 0.0
    for index, now in enumerate(np.cumsum([0.1, 0.1, 0.25, 0.1, 0.05, 0.4, 0.1, 0.1]), start=1):
        y = rate * now + SEEN * rng.standard_normal(D)
        draws = follow(update_of(state, now, y, index))
        kalman.predict(now - then)
        kalman.see(y)
        kalman.check(draws.poses, draws.rates, draws.log_weights, 0.2)
        log_weights, _ = normalise(draws.log_weights)
        # What an earlier frame's surprise adds to the noise is tested on its own.
        state, then = replace(state, poses=draws.poses, rates=draws.rates, log_weights=log_weights, time_s=now), now


def test_the_rates_of_a_steady_motion_are_learned():
    """From nothing known to the truth within three of the stated deviations, and those fall to a fifth."""
    rng = philox(3, 4)
    rate = np.sqrt(V0) * rng.choice([-1.0, 1.0], D)
    state = start(rng, np.zeros(D))
    for index in range(1, 11):
        now = 0.2 * index
        draws = follow(update_of(state, now, rate * now + SEEN * rng.standard_normal(D), index))
        log_weights, _ = normalise(draws.log_weights)
        state = replace(state, poses=draws.poses, rates=draws.rates, log_weights=log_weights, time_s=now)
    mean, covariance = moments(state.poses, state.rates, state.log_weights)
    deviation = np.sqrt(np.diag(covariance))[D:]
    assert np.all(deviation < 0.6 * np.sqrt(V0 / R))
    assert np.all(np.abs(mean[D:] - rate / np.sqrt(R)) < 3 * deviation)


@pytest.mark.parametrize("gap_s", [0.1, 1.0, 4.0])
def test_a_gap_widens_the_prediction_by_the_right_amount(gap_s):
    """P + V dt^2 + q dt + r dt^3 / 3 about the pose carried on; rates V + r dt; both in closed form."""
    rate = 0.3 * np.sqrt(V0)
    state = start(philox(5, 6), rate)
    kalman = Kalman(rate)
    kalman.predict(gap_s)
    (part,) = predicted_components(update_of(state, gap_s, None))
    assert part.log_weight == pytest.approx(0)
    np.testing.assert_allclose(local(ORIGIN, part.mean)[0], kalman.mean[:, 0], rtol=0.03)
    np.testing.assert_allclose(np.diag(part.covariance), kalman.covariance[:, 0, 0], rtol=0.01)
    rates = part.rate_slope @ part.covariance @ part.rate_slope.T + part.rate_factor @ part.rate_factor.T
    np.testing.assert_allclose(np.diag(rates), kalman.covariance[:, 1, 1], rtol=0.01)
    np.testing.assert_allclose(np.diag(part.rate_slope @ part.covariance), kalman.covariance[:, 0, 1], rtol=0.02)


def test_a_prediction_over_a_gap_is_that_over_its_halves():
    """White noise in the rate, integrated: one step of 2 s is two steps of 1 s, covariances and all."""
    state = start(philox(5, 6), np.zeros(D))
    (whole,) = predicted_components(update_of(state, 2.0, None))
    exact = V0 * 2.0 + R * 2.0**2 / 2
    np.testing.assert_allclose(np.diag(whole.rate_slope @ whole.covariance), exact, rtol=0.02)


def test_surprise_widens_the_prediction_and_never_narrows_it():
    state = start(philox(5, 6), np.zeros(D))
    diagonals = []
    for surprise in (0.1, 1.0, 4.0, 100.0):
        odd = replace(state, memory={**state.memory, "surprise": np.array(surprise)})
        (part,) = predicted_components(update_of(odd, 0.5, None))
        diagonals.append(np.diag(part.covariance) - X0**2 - 0.25 * V0)
    own = Q * 0.5 + R * 0.5**3 / 3
    np.testing.assert_allclose(diagonals, np.outer([1, 1, 4, 9], own), rtol=0.05)


def blank(state: FilterState, frames: int, dt_s: float) -> list[FilterState]:
    """The states after frames that show nothing."""
    told = []
    for index in range(1, frames + 1):
        found = unseen(update_of(state, state.time_s + dt_s, None, index))
        state = replace(
            state, poses=found.poses, rates=found.rates, log_weights=found.log_weights, time_s=state.time_s + dt_s
        )
        told.append(state)
    return told


SHOWN = [0, 1, 2, 3, 4, 6]  # the scale is kept while nothing is seen


def test_blank_frames_keep_widening_the_prediction():
    """At least by what is known of the rates and by the jitter, P + V T^2 + q T, frame after frame."""
    rate = 0.2 * np.sqrt(V0)
    previous = X0**2
    for k, state in enumerate(blank(start(philox(7, 8), rate), 8, 0.1), start=1):
        time_s = 0.1 * k
        mean, covariance = moments(state.poses, state.rates, state.log_weights)
        variance = np.diag(covariance)[:D] * Q
        least = X0**2 + V0 * time_s**2 + Q * time_s
        assert np.all(variance[SHOWN] > 0.9 * least[SHOWN])
        assert np.all(variance[SHOWN] > previous[SHOWN])
        np.testing.assert_allclose(
            (mean[:D] * np.sqrt(Q))[SHOWN], (rate * time_s)[SHOWN], atol=0.1 * np.sqrt(least).max()
        )
        previous = variance


def test_blank_frames_widen_as_much_as_the_gap_that_they_are():
    """Eight blank frames of 0.25 s are a gap of 2 s: P + V T^2 + q T + r T^3 / 3, and V + r T of the rates."""
    state = blank(start(philox(7, 8), np.zeros(D)), 8, 0.25)[-1]
    _, covariance = moments(state.poses, state.rates, state.log_weights)
    expected = X0**2 + V0 * 4 + Q * 2 + R * 8 / 3
    np.testing.assert_allclose(np.diag(covariance)[:D] * Q, expected, rtol=0.1)
    np.testing.assert_allclose(np.diag(covariance)[D:] * R, V0 + R * 2, rtol=0.1)
