"""Modes and clutter of a checkpoint (``inference.state``), held against what the filter will take for granted."""

from __future__ import annotations

import numpy as np

from service.imaging.clutter import SIZES
from service.inference.state import Array, Clutter, Displaced, Mixture

_LARGEST = 1e9  # px, degrees, seconds, units: whatever is larger is no state of a track
_MOST_MODES, _MOST_SPAN_PX, _MOST_SIDE = 64, 1e5, 1 << 14
_UNIT = 1e-6  # how far a length or a sum of probabilities may be from 1


def check_mixture(mixture: Mixture, n_joints: int) -> None:
    """Raises ``ValueError`` where these are no modes of a session with so many free joints."""
    _check_arrays(mixture, 6 + n_joints)
    for vectors in (mixture.poses.quaternion, mixture.suns):
        if np.abs(np.linalg.norm(vectors, axis=1) - 1).max() > _UNIT:
            raise ValueError("a direction of the mixture is not of length 1")
    for shares in (np.exp(mixture.log_weights), mixture.existence):
        if shares.min() < 0 or abs(float(shares.sum()) - 1) > _UNIT:
            raise ValueError("the mixture's probabilities do not sum to 1")
    if not all(_is_positive(covariance) for covariance in mixture.covariance):
        raise ValueError("a covariance of the mixture is not positive")
    if min(mixture.paint[:, 1].min(initial=0.0), mixture.log_chi2[1], mixture.sun_sigmas.min() - 1e-9) < 0:
        raise ValueError("something that the mixture has learnt has no variance")
    if mixture.log_discrepancy is not None and mixture.log_discrepancy[1] < 0:
        raise ValueError("what the mixture knows of the discrepancy has no variance")
    _check_numbers(mixture)
    if mixture.displaced is not None:
        _check_displaced(mixture, mixture.displaced, 6 + n_joints)


def _check_arrays(mixture: Mixture, d: int) -> None:
    poses, n = mixture.poses, len(mixture.log_weights)
    shapes = {
        "quaternion": (poses.quaternion, (n, 4)),
        "position": (poses.position, (n, 2)),
        "log_scale": (poses.log_scale, (n,)),
        "joints": (poses.joints, (n, d - 6)),
        "rates": (mixture.rates, (n, d)),
        "covariance": (mixture.covariance, (n, 2 * d, 2 * d)),
        "suns": (mixture.suns, (n, 3)),
        "sun_sigmas": (mixture.sun_sigmas, (n,)),
        "paint": (mixture.paint, (n, 2, mixture.paint.shape[-1] if mixture.paint.ndim else 0)),
        "log_weights": (mixture.log_weights, (n,)),
        "existence": (mixture.existence, (3,)),
        "point_spread": (mixture.point_spread, (2,)),
        "log_chi2": (mixture.log_chi2, (2,)),
        "log_discrepancy": (np.zeros(2) if mixture.log_discrepancy is None else mixture.log_discrepancy, (2,)),
    }
    for name, (array, shape) in shapes.items():
        if array.shape != shape or array.dtype != np.float64 or not 1 <= n <= _MOST_MODES:
            raise ValueError(f"the mixture's {name} is {array.dtype} {array.shape}, not float64 {shape}")
        if not (np.abs(array) <= (50.0 if name == "log_scale" else _LARGEST)).all():
            raise ValueError(f"the mixture's {name} is not finite, or too large")


def _check_displaced(mixture: Mixture, displaced: Displaced, d: int) -> None:
    pose, chance = displaced.pose, displaced.probability
    arrays = pose.quaternion, pose.position, pose.log_scale, pose.joints, displaced.rates
    if [one.shape for one in arrays] != [(1, 4), (1, 2), (1,), (1, d - 6), (1, d)]:
        raise ValueError("what was displaced is no single answer")
    if not all(one.dtype == np.float64 and (np.abs(one) <= _LARGEST).all() for one in arrays):
        raise ValueError("what was displaced is not finite, or too large")
    if type(chance) is not float or not 0 <= chance < 1 or abs(np.linalg.norm(pose.quaternion) - 1) > _UNIT:
        raise ValueError("what was displaced has no probability, or no direction")
    if type(displaced.since_s) is not float or not 0 <= displaced.since_s <= _LARGEST:
        raise ValueError(f"what was displaced is so since {displaced.since_s!r} s")
    if displaced.was is not None:
        if displaced.was.paint.shape != (1, *mixture.paint.shape[1:]) or displaced.was.displaced is not None:
            raise ValueError("what was displaced is no single mode of this mixture")
        check_mixture(displaced.was, d - 6)


def _is_positive(covariance: Array) -> bool:
    variance = np.diag(covariance)
    if variance.min() <= 0:
        return False
    return bool(np.linalg.eigvalsh(covariance / np.sqrt(np.outer(variance, variance))).min() > -_UNIT)


def _check_numbers(mixture: Mixture) -> None:
    core, wings = mixture.point_spread
    bounds = {
        "discrepancy": (mixture.discrepancy, float, 1e-9, 1.0),
        "log_light": (mixture.log_light, float, -_LARGEST, _LARGEST),
        "span_px": (mixture.span_px, float, 1.0, _MOST_SPAN_PX),
        "photon": (1.0 if mixture.photon is None else mixture.photon, float, 1e-12, _LARGEST),
        "hides": (0.0 if mixture.hides is None else mixture.hides, float, 0.0, _LARGEST),
        "core": (float(core), float, 1e-9, _LARGEST),
        "wings": (float(wings), float, 0.0, _LARGEST),
        "sharpened": (mixture.sharpened, float, 0.0, _LARGEST),
        "mask": (mixture.mask, float, 0.0, _LARGEST),
        "searches": (mixture.searches, int, 0, _LARGEST),
        "misses": (mixture.misses, int, 0, _LARGEST),
        "since_search": (mixture.since_search, int, 0, _LARGEST),
        "searched_nats": (mixture.searched_nats, float, -_LARGEST, _LARGEST),
        "parts_searched": (mixture.parts_searched, int, 0, _LARGEST),
        "answered": (mixture.answered, float, 0.0, 1.0),
        "ever_tracked": (mixture.ever_tracked, bool, 0, 1),
    }
    for name, (value, kind, low, high) in bounds.items():
        if type(value) is not kind or not low <= value <= high:
            raise ValueError(f"the mixture's {name} is {value!r}")


def check_clutter(known: Clutter) -> None:
    """Raises ``ValueError`` where this is nothing that is known of a body before clutter."""
    for density in (known.body, known.clutter):
        if density.dtype != np.float32 or density.shape not in [(size,) for size in SIZES]:
            raise ValueError(f"colours are {density.dtype} {density.shape}")
        if not (np.abs(density) <= _LARGEST).all() or density.shape != known.body.shape:
            raise ValueError("colours are not finite, or of two kinds")
    picture, corner = known.picture, known.corner
    if picture.ndim != 2 or picture.dtype != np.uint8 or not 1 <= picture.shape[0] == picture.shape[1] <= _MOST_SIDE:
        raise ValueError(f"the last picture is {picture.dtype} {picture.shape}")
    if corner.shape != (2,) or corner.dtype != np.float64 or not (np.abs(corner) <= _LARGEST).all():
        raise ValueError("the last picture's corner is no place")
    for value, least in ((known.low, -_LARGEST), (known.span, 1e-9)):
        if type(value) is not float or not least <= value <= _LARGEST:
            raise ValueError(f"grey levels from {known.low!r} on, over {known.span!r}")
