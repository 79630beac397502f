"""Three hypotheses of a frame (docs/model.md, section 6): nothing there; this body; something else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import betaln

from service.inference.model import prior
from service.inference.model.drawing import EVEN_PLANES
from service.inference.model.likelihood import Fit, t_log_density
from service.inference.model.scene import Scene
from service.inference.model.spread import gradient
from service.inference.numerics.hill import Hill
from service.inference.state import Array, Goodness

ABSENT, FITS, NO_FIT = range(3)
_LEAST_CHI2 = 1e-3  # numerical: so that it has a logarithm
_TIMES = 2.0  # numerical: and half of it: where a parabola goes through the evidence of a discrepancy
_LOG_TAUS = np.log(prior.DISCREPANCY_OWN) + 0.05 * (np.arange(84) + 0.5)  # numerical: middles of cells, to 0.33
_KNOWN = 400.0  # numerical: information of a log that is as good as known


def expected(before: Array | None, dt_s: float) -> Array:
    """(3,) probabilities ahead of a frame, from those after the last one; None: there was none."""
    if before is None:
        return np.array(prior.EXISTENCE)
    stays = np.exp(-prior.CHANGES_PER_S * dt_s)
    return np.asarray(stays * before + (1 - stays) * np.array(prior.EXISTENCE))


def log_absent(hill: Hill) -> float:
    """Log evidence of the sky alone."""
    side, planes = hill.view.side, len(hill.terms.offset) + EVEN_PLANES
    nothing, terms = np.zeros((1, planes, 1, side), np.float32), replace(hill.terms, stars=hill.scene.stars_alone)
    return float(hill.log_evidences(nothing, terms)[0])


def scene_unlike(hill: Hill) -> Scene:
    """Light lies about where a pose has it, and is wrong everywhere: as of another body. Other light is left out, so
    its evidence is a least.
    """
    return hill.scene.under(discrepancy=prior.UNLIKE)


def log_unlike_of(hill: Hill, fit: Fit) -> float:
    """Log density of a frame as of another body, its light not fitted anew: what evidence cannot be far above."""
    scene, (dx, dy) = scene_unlike(hill), gradient(fit.light)
    white = (scene.sigma**2 + scene.photon * np.maximum(fit.light, 0)) / scene.area
    edges = (scene.grain * prior.EDGE_PX) ** 2 * (dx**2 + dy**2)
    variance = np.asarray(white + scene.alike * scene.discrepancy**2 * (fit.light**2 + edges), np.float32)
    return float(np.sum(t_log_density(fit.residual, variance, scene.censored), dtype=np.float64)) / scene.area


def log_light(hill: Hill, fit: Fit) -> float:
    """Log of a body's whole light, counts of frame pixels."""
    return float(np.log(max(float(np.sum(fit.light)), hill.scene.sigma))) + 2 * float(np.log(hill.view.binning))


def log_of_change(before: float | None, now: float, answered: float = 1.0) -> float:
    """Log density of a body's light after what it was, over that of the gain's own prior, which is as good as flat: it
    seldom goes out.

    ``answered``: probability that what it was is this body's; else it says nothing.
    """
    if before is None or answered <= 0:
        return 0.0
    change = float(np.log(prior.GAIN_SIGMA / prior.FADES)) - 0.5 * ((now - before) / prior.FADES) ** 2
    return float(np.logaddexp(np.log(answered) + change, np.log1p(-answered))) if answered < 1 else change


def usual_light(before: float | None, now: float, fits: float) -> float:
    """Log of the light that is expected next: what it was, or where this is not the body's it is slowly doubted."""
    return now if before is None or fits >= 0.5 else before + (1 - prior.PAINT_DOUBTED) * (now - before)


def log_of_disturbance(chi2: float, level: Array) -> float:
    """Log density of the mean square that is left over where something has come between, over that of where this body
    fits: then no more is left than it has left until now (``level``, mean and variance of its log).

    A Student t about the level; better is no less usual, worse no less a disturbance.
    """
    nu, at = prior.LOG_CHI2_FREEDOM, float(np.log(max(chi2, _LEAST_CHI2)))
    mean, variance = level[0], level[1] + prior.LOG_CHI2_JITTER**2
    usual = -0.5 * (nu + 1) * np.log1p(max(at - mean, 0.0) ** 2 / (nu * variance)) - 0.5 * np.log(variance)
    rise, sigma = prior.LOG_CHI2_DISTURBED
    sigma = float(np.hypot(sigma, np.sqrt(level[1])))
    disturbed = -0.5 * min((at - mean - rise) / sigma, 0.0) ** 2 - np.log(sigma)
    return float(disturbed - usual)


def usual_chi2(before: Array | None = None, chi2: float = 1.0, fits: float = 0.0) -> Array:
    """(2,) mean and variance of the log of what a body leaves over, after a frame that it fits so probably.

    The update of a Student t: what lies far off says little of the level. None: nothing was seen of it.
    """
    if before is None:
        return np.array([prior.LOG_CHI2[0], prior.LOG_CHI2[1] ** 2])
    mean, variance = before
    if fits >= 0.5:
        away, wide = float(np.log(max(chi2, _LEAST_CHI2))) - mean, variance + prior.LOG_CHI2_JITTER**2
        nu = prior.LOG_CHI2_FREEDOM
        gain = variance / wide * min((nu + 1) / (nu + away**2 / wide), 1.0)
        mean, variance = mean + gain * away, (1 - gain) * variance
    return np.array([mean, variance + prior.LOG_CHI2_DRIFT**2])


def level_if(level: Array, answered: float) -> Array:
    """(2,) mean and variance of the level if ``level`` is this body's with a probability, else as of any body's."""
    both, weights = np.stack([level, usual_chi2()]), np.array([answered, 1 - answered])
    mean = float(weights @ both[:, 0])
    return np.array([mean, weights @ (both[:, 1] + (both[:, 0] - mean) ** 2)])


def missed(searches: int, misses: int = 0, *, nats: float) -> float:
    """Probability that the truth was met by none of so many searches that found nothing better.

    ``misses``: searches that are known to have missed it, since a later one did better. ``nats``: log evidence of the
    best mode against the empty sky in the frames that were searched, their mean: where it is little, much else explains
    such a frame as well.
    """
    share = share_met(nats)
    a, b = (max(prior.SEARCH_WEIGHT * part, 1e-3) for part in (share, 1 - share))  # a Beta law has no ends at zero
    return float(np.exp(betaln(a, b + misses + searches) - betaln(a, b + misses)))


def share_met(nats: float) -> float:
    """Share of searches that meet a truth of such evidence against the empty sky, from body to body in the mean."""
    return 1 / (1 + (prior.SEARCH_HALF / max(nats, 1.0)) ** 2)


def nats_of_search(nats: float, hidden: float) -> float:
    """Nats of a whole body that searches meet as often as one of which a share of the light is ``hidden``."""
    if hidden == 0:
        return nats
    share = (1 - prior.HIDDEN_MISSED * hidden) * share_met(nats)
    return prior.SEARCH_HALF * float(np.sqrt(share / (1 - share)))


def hidden_share(hill: Hill, fit: Fit) -> float:
    """Of a body's light, what lies where nothing is known: beyond the frame's edge, as a rule."""
    unknown = hill.scene.unknown
    if not unknown.any():
        return 0.0
    whole = float(np.sum(fit.light))
    return float(np.clip(np.sum(fit.light[unknown]) / whole, 0.0, 1.0)) if whole > 0 else 0.0


def scenes_about(hill: Hill) -> tuple[Scene, Scene]:
    """A hill's scene with half and with twice its discrepancy."""
    below, above = (hill.scene.under(discrepancy=times * hill.scene.discrepancy) for times in (1 / _TIMES, _TIMES))
    return below, above


def log_discrepancy(discrepancy: float, gains: tuple[float, float]) -> Array:
    """(2,) pull and information of the log of a discrepancy, by a parabola through a frame's log evidence.

    ``gains``: what log evidence gains with half and with twice of it (``scenes_about``), nats.
    """
    (below, above), step = gains, float(np.log(_TIMES))
    information = max(-(below + above) / step**2, 0.0)
    return np.array([(above - below) / (2 * step) + information * float(np.log(discrepancy)), information])


def log_discrepancy_so_far(before: Array | None, now: Array, fits: float) -> Array:
    """(2,) of all frames: it is the same in all, but drawings err in the same places. None: there were no others."""
    if before is None:
        return now
    return now + prior.MEMORY_KEPT * before if fits >= 0.5 else before


def log_discrepancy_known(discrepancy: float) -> Array:
    """(2,) of one that is known."""
    return _KNOWN * np.array([np.log(discrepancy), 1.0])


def of_this_body(told: Array, mesh_error: float = 0.0) -> float:
    """Probability that the model is the body's, by what frames say of the discrepancy that it asks for.

    ``told`` (2,): ``log_discrepancy_so_far``. A mesh that is known to be off, by ``mesh_error``, asks for more of its
    own.
    """
    least = float(np.hypot(prior.DISCREPANCY_OWN, prior.MESH_DISCREPANCY * mesh_error))
    median, sigma = prior.DISCREPANCY_UNLIKE
    own = -0.5 * (np.maximum(_LOG_TAUS - np.log(least), 0.0) / prior.DISCREPANCY_OWN_LOG_SIGMA) ** 2
    own += np.log(2 / prior.DISCREPANCY_OWN_LOG_SIGMA)
    other = -0.5 * ((_LOG_TAUS - np.log(median)) / sigma) ** 2 - np.log(sigma)
    pull, information = told
    frames = pull * _LOG_TAUS - 0.5 * information * _LOG_TAUS**2
    fitted, unlike = (np.logaddexp.reduce(law + frames) for law in (own, other))
    _, fits, no_fit = prior.EXISTENCE
    return float(1 / (1 + no_fit / fits * np.exp(unlike - fitted)))


def goodness(hill: Hill, fit: Fit) -> Goodness:
    """What an answer says of its best mode's light."""
    scene = hill.scene
    noise = scene.sigma / np.sqrt(scene.area)
    seen = np.abs(scene.data) > 2 * noise
    light = float(np.sum(np.abs(scene.data[seen])))
    left = float(np.sum(np.abs(fit.residual[seen])))
    body = (fit.light > noise) & ~scene.censored
    dark = float(np.mean(~seen[body])) if body.any() else 0.0
    return Goodness(fit.chi2, float(np.clip(1 - left / light, 0.0, 1.0)) if light > 0 else 0.0, dark)
