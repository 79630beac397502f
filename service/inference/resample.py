"""Resampling: (N,) log weights -> (M,) ancestor indices. Each scheme draws index j M w_j times on average."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from service.inference.state import Array

Ancestors = NDArray[np.intp]


def _cumulative(log_weights: Array) -> Array:
    """c_j, the cumulative weights, with the last exactly 1 so that every r in [0, 1) falls on a particle."""
    total = np.cumsum(np.exp(log_weights - np.max(log_weights)))
    return np.asarray(total / total[-1])


def _invert(log_weights: Array, r: Array) -> Ancestors:
    """Smallest j with c_j > r for r in [0, 1); a particle of zero weight has c_j = c_(j-1) and is never drawn.

    (u + M - 1) / M rounds up to 1 for u just below 1, which would be past the last particle.
    """
    below_one = np.minimum(r, np.nextafter(1.0, 0.0))
    return np.searchsorted(_cumulative(log_weights), below_one, side="right")


def multinomial(rng: np.random.Generator, log_weights: Array, count: int) -> Ancestors:
    """Eq. 6 as written: cumulative weights c_j; r uniform; the smallest j with c_j >= r; a fresh r per particle.

    r is drawn from (0, 1], so that r = 0 cannot pick a leading particle of zero weight.
    """
    r = 1.0 - rng.random(count)
    return np.searchsorted(_cumulative(log_weights), r, side="left")


def systematic(rng: np.random.Generator, log_weights: Array, count: int) -> Ancestors:
    """One r for all: points (r + i) / M (Kitagawa 1996). Low variance; keeps the order."""
    return _invert(log_weights, (rng.random() + np.arange(count)) / count)


def stratified(rng: np.random.Generator, log_weights: Array, count: int) -> Ancestors:
    """One r in each of M equal strata (Kitagawa 1996)."""
    return _invert(log_weights, (rng.random(count) + np.arange(count)) / count)


def residual(rng: np.random.Generator, log_weights: Array, count: int) -> Ancestors:
    """floor(M w_j) copies of each particle, the rest multinomial on the remainders (Liu and Chen 1998)."""
    expected = count * np.exp(log_weights - np.max(log_weights)) / np.sum(np.exp(log_weights - np.max(log_weights)))
    copies = np.floor(expected).astype(np.intp)
    kept = np.repeat(np.arange(len(log_weights)), copies)
    if len(kept) >= count:
        return kept[:count]
    with np.errstate(divide="ignore"):
        rest = multinomial(rng, np.log(expected - copies), count - len(kept))
    return np.concatenate([kept, rest])


RESAMPLERS: dict[str, Callable[[np.random.Generator, Array, int], Ancestors]] = {
    "multinomial": multinomial,
    "systematic": systematic,
    "stratified": stratified,
    "residual": residual,
}
