"""The light's pose and its covariance, where the model has made the frame: the truth lies in the 50 and 90 % regions
as often as they say.

Albedos, even light, gloss, the Sun and the noise are drawn from what the likelihood believes of them, poses near a
mode; the discrepancy is next to nothing. This checks the code, not the world.
"""

import numpy as np
import pytest
from lit_body import FINEST, SUN, VIEW, lit_body, pose, scene, seen
from scipy import stats

from service.inference.model import prior
from service.inference.model.derivatives import across
from service.inference.model.drawing import Quality
from service.inference.numerics.gauss_newton import ascend
from service.inference.numerics.hill import Hill
from service.inference.numerics.priors import PosePrior
from service.inference.pose import local, retract

DRAWS = 60
SIGMA, GAIN = 60.0, 500.0  # noise well above the samples at the edges of what is drawn
FINE = Quality(supersample=6, shadow_px=384)
SUN_SIGMA = np.deg2rad(1.0)
AWAY = np.array([0.15, 0.15, 0.15, 1.5, 1.5, 0.05, 10.0])  # of the truths from one pose
OFF = np.array([0.01, 0.01, 0.01, 0.3, 0.3, 0.01, 2.0])  # of a climb's start from the truth
D = len(AWAY)


def light(rng: np.random.Generator) -> np.ndarray:
    """(Q,) coefficients from their priors."""
    n = lit_body().n_groups
    albedo = np.exp(prior.ALBEDO_SIGMA * rng.normal(size=n))
    even = max(prior.EVEN_MEAN + prior.EVEN_SIGMA * rng.normal(), 0.0)
    tilt = prior.EVEN_TILT_SIGMA * rng.normal(size=3)
    gloss = prior.GLOSS_SHARE * np.exp(prior.GLOSS_LOG_SIGMA * rng.normal(size=n))
    return (GAIN * np.concatenate([albedo, [even], tilt, gloss])).astype(np.float32)


def squared_errors(low_pass: float, seed: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """(DRAWS,) of pose and of the Sun, each in its own covariance."""
    rng = np.random.default_rng(seed)
    drawing, poses, suns = lit_body(), [], []
    for _ in range(DRAWS):
        truth = retract(pose(), AWAY * rng.uniform(-1, 1, (1, D)))
        told = SUN + SUN_SIGMA * rng.normal(size=2) @ across(SUN)
        told /= np.linalg.norm(told)
        image = seen(truth, light(rng), quality=FINE)
        given = scene(image + rng.normal(0, SIGMA, image.shape), SIGMA, low_pass=low_pass)
        hill = Hill(given, drawing, VIEW, PosePrior(None, 0.03, told, SUN_SIGMA), FINE)
        start = retract(truth, OFF * rng.normal(size=(1, D)))
        found = ascend(hill, start, told[None].copy(), steps=12)[0]
        error = local(found.pose, truth)[0]
        poses.append(error @ np.linalg.solve(found.covariance, error))
        suns.append(float(np.sum((found.sun - SUN) ** 2)))
    return np.array(poses), np.array(suns)


def inflation() -> float:
    """By how much squared errors exceed their covariance: Gaussian noise is believed to be a Student t's.

    Curvature is made of the weights w = (nu + 1) / (nu + z^2); with psi = w z, errors have E psi^2 / (E psi')^2.
    """
    nu = prior.DEGREES_OF_FREEDOM
    z = np.linspace(-9, 9, 2001)
    chance = stats.norm.pdf(z) * (z[1] - z[0])
    weight = (nu + 1) / (nu + z**2)
    slope = (nu + 1) * (nu - z**2) / (nu + z**2) ** 2
    return float(chance @ (weight * z) ** 2 * (chance @ weight) / (chance @ slope) ** 2)


def chance(squares: np.ndarray, share: float) -> float:
    """Of a count of truths in this region that is as far from its mean as this one."""
    inside = int(np.sum(squares < stats.chi2.ppf(share, D)))
    return float(stats.binomtest(inside, len(squares), share).pvalue)


def test_the_truth_lies_in_the_regions_as_often_as_they_say():
    """White noise, pixels that count one by one."""
    squares, suns = squared_errors(FINEST)
    assert 1.05 < inflation() < 1.2
    assert chance(squares / inflation(), 0.5) > 0.05
    assert chance(squares / inflation(), 0.9) > 0.05
    assert np.mean(squares) == pytest.approx(inflation() * D, abs=3 * np.sqrt(2 * D / DRAWS))
    assert 0.5 < np.mean(suns) / (2 * SUN_SIGMA**2) < 1.5


def test_the_frames_own_low_pass_makes_regions_no_smaller_and_little_larger():
    """Pixels are alike over an area that counts as one: at detail as fine as the point spread that is a little many."""
    squares, _ = squared_errors(0.0)
    assert np.mean(squares < stats.chi2.ppf(0.9, D)) > 0.9 - 2 * np.sqrt(0.09 / DRAWS)
    assert 0.6 * D < np.mean(squares) < 1.2 * D
