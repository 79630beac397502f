"""Simulation-based calibration: the truth's rank among posterior draws is uniform (Talts et al. 2018).

A pose is drawn from the prior, a measurement from the pose, and the filter told the measurement: where the prior and
the likelihood are the model's own, no quantile of the posterior may hold the truth more often than another. The
likelihood is neither Gaussian nor linear, and is taken with the exponent 1.
"""

import numpy as np
import pytest
from scipy import stats

from service.inference.articulation import Articulation, Joint, Stage
from service.inference.domain import Domain
from service.inference.mixture import Draws, posterior
from service.inference.motion import motion_noise
from service.inference.params import FilterParams, LikelihoodParams, MotionParams, PriorParams, SessionConfig
from service.inference.pose import local, retract
from service.inference.proposal import Component
from service.inference.resample import multinomial
from service.inference.state import FilterState, Frame, Measurement, Poses
from service.inference.tracking import follow
from service.inference.update import Update
from service.inference.weights import normalise

D = 7
RANKS = 20  # of one truth among 19 draws
ORIGIN = Poses(np.array([[0.5, -0.5, 0.5, 0.5]]), np.array([[200.0, 200.0]]), np.array([1.0]), np.array([[0.0]]))
DEVIATION = np.array([0.06, 0.05, 0.04, 3.0, 2.0, 0.1, 8.0])
TAILS = 5.0  # degrees of freedom of the measurement's noise
NOISE = 0.5  # its scale, in the prior's deviations


def philox(*key: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(key=np.array(key, np.uint64)))


def bent(x: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """What is measured of tangent coordinates: each with a little of the square of its neighbour."""
    z = x / unit
    return z + 0.2 * np.roll(z, 1, axis=-1) ** 2


def log_likelihood(x: np.ndarray, y: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """(N,) of independent Student t noise in every coordinate, up to a constant."""
    off = (bent(x, unit) - y) / NOISE
    return -0.5 * (TAILS + 1) * np.sum(np.log1p(off**2 / TAILS), axis=1)


def rank(rng: np.random.Generator, draws: Draws, truth: np.ndarray, log_weights: np.ndarray) -> np.ndarray:
    """(2 D,) how many of 19 posterior draws lie below the truth, per coordinate of pose and rates."""
    chosen = multinomial(rng, normalise(log_weights)[0], RANKS - 1)
    values = np.hstack([local(ORIGIN, draws.poses[chosen]), draws.rates[chosen]])
    return np.asarray(np.sum(values < truth, axis=0))


def least_chance(ranks: np.ndarray, bins: int = RANKS) -> float:
    """The smallest chi-square p-value over the coordinates."""
    counts = np.stack([np.bincount(column, minlength=bins) for column in ranks.T])
    return float(np.min(stats.chisquare(counts, axis=1).pvalue))


SLOPE = np.diag(np.linspace(-1.0, 1.0, D))
PARTS = [
    Component(np.log(0.3), ORIGIN, np.diag(DEVIATION**2), np.zeros(D), SLOPE, np.diag(DEVIATION)),
    Component(
        np.log(0.7),
        retract(ORIGIN, 0.8 * DEVIATION[None]),
        0.25 * np.diag(DEVIATION**2),
        DEVIATION,
        SLOPE,
        np.diag(DEVIATION),
    ),
]


@pytest.fixture(scope="module")
def mixture_ranks() -> tuple[np.ndarray, np.ndarray]:
    """Ranks of 400 truths under a prior of two modes that overlap; also those without the weights."""
    ranks, unweighted = [], []
    for run in range(400):
        rng = philox(11, run)
        part = PARTS[int(rng.random() < 0.7)]
        x = rng.standard_normal(D) * np.sqrt(np.diag(part.covariance))
        rates = part.rate_mean + part.rate_slope @ x + part.rate_factor @ rng.standard_normal(D)
        pose = local(ORIGIN, retract(part.mean, x[None]))
        y = bent(pose, DEVIATION) + NOISE * rng.standard_t(TAILS, D)

        def score(poses: Poses, y: np.ndarray = y) -> np.ndarray:
            return log_likelihood(local(ORIGIN, poses), y, DEVIATION)

        draws = posterior(rng, PARTS, score, 1.0, 300)
        truth = np.concatenate([pose[0], rates])
        ranks.append(rank(rng, draws, truth, draws.log_weights))
        unweighted.append(rank(rng, draws, truth, np.zeros(300)))
    return np.array(ranks), np.array(unweighted)


def test_ranks_of_poses_and_rates_are_uniform(mixture_ranks):
    assert least_chance(mixture_ranks[0]) > 1e-3


def test_the_ranks_would_show_it_if_weights_were_left_out(mixture_ranks):
    assert least_chance(mixture_ranks[1]) < 1e-5


BOOM = Joint("boom", "prismatic", -1000, 1000, 0.0, (Stage("prismatic", ("boom",), (0, 0, 1)),))
DOMAIN = Domain(400, 400, 1.0, Articulation(("bus", "boom"), (BOOM,)), PriorParams(0.001, 10.0))
CONFIG = SessionConfig(
    filter=FilterParams(particles=400),
    likelihood=LikelihoodParams(exponent=1.0),
    motion=MotionParams(rotation_deg=1.0, position=0.005, rate_spread=3.0, joint_range=0.002),
)
MOTION = motion_noise(CONFIG.motion, DOMAIN)
UNIT = np.sqrt(MOTION.jitter)
DT_S = 0.2


def follow_once(run: int, frames: int) -> tuple[np.ndarray, Draws, np.random.Generator]:
    """A truth from the model's own motion, followed for some frames; (2 D,) where it ended."""
    rng = philox(12, run)
    count = 1000
    v = np.sqrt(MOTION.variance) * rng.standard_normal(D)
    x = 0.3 * UNIT * rng.standard_normal(D)
    poses = Poses(*(np.repeat(a, count, axis=0) for a in vars(ORIGIN).values()))
    draws = Draws(
        retract(poses, rng.standard_normal((count, D)) * 0.3 * UNIT),
        rng.standard_normal((count, D)) * np.sqrt(MOTION.variance),
        np.zeros(count),
        np.zeros(count),
    )
    for index in range(1, frames + 1):
        x = x + v * DT_S
        x = x + np.sqrt(MOTION.jitter * DT_S + MOTION.change * DT_S**3 / 3) * rng.standard_normal(D)
        v = v + np.sqrt(MOTION.change * DT_S) * rng.standard_normal(D)
        y = bent(x, UNIT) + NOISE * rng.standard_t(TAILS, D)

        def score_maps(poses: Poses, maps: np.ndarray, y: np.ndarray = y) -> np.ndarray:
            return log_likelihood(local(ORIGIN, poses), y, UNIT)[:, None]

        state = FilterState(
            draws.poses, normalise(draws.log_weights)[0], draws.rates, index - 1, (index - 1) * DT_S, "tracking"
        )
        frame = Frame(index, index * DT_S, Measurement(np.zeros((2, 2), np.float32), 0.0))
        draws = follow(Update(rng, state, frame, score_maps, CONFIG, DOMAIN, ()))
    return np.concatenate([x, v]), draws, rng


def test_ranks_are_uniform_after_three_frames_of_following():
    """120 tracks; the posterior of a frame is the prior of the next as a Gaussian, which is all that is approximate."""
    ranks = []
    for run in range(120):
        truth, draws, rng = follow_once(run, 3)
        ranks.append(rank(rng, draws, truth, draws.log_weights))
    assert least_chance(np.array(ranks) // 4, RANKS // 4) > 1e-3
