"""Weights: in the log domain normalised, effective sample size; and the moments that they weigh."""

from __future__ import annotations

import numpy as np

from service.inference.state import Array


def log_sum_exp(values: Array) -> float:
    """log sum exp of (N,) values, exact for any magnitude; -inf when every value is -inf."""
    top = float(np.max(values))
    if not np.isfinite(top):
        return top
    return top + float(np.log(np.sum(np.exp(values - top))))


def normalise(log_weights: Array) -> tuple[Array, float]:
    """(N,) log weights -> (log weights that sum to 1, log of their sum).

    Raises ``FloatingPointError`` when no weight is positive: an image that no particle explains is a fact about
    the caller's likelihood (it must have a floor), not something to hide behind uniform weights.
    """
    total = log_sum_exp(log_weights)
    if not np.isfinite(total):
        raise FloatingPointError(f"the log weights sum to {total}")
    return log_weights - total, total


def effective_sample_size(log_weights: Array) -> float:
    """1 / sum of squared normalised weights (Kong), between 1 and N."""
    return float(np.exp(2 * log_sum_exp(log_weights) - log_sum_exp(2 * log_weights)))


def second_moment(weights: Array, x: Array) -> Array:
    """(D, D) sum over N of w x x' of (N, D) ``x``; an ``einsum`` of three takes ten times as long."""
    return np.asarray((weights[:, None] * x).T @ x)
