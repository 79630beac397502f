"""A checkpoint's modes: what the tracker would stumble over is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.inference.state import FilterState, Mixture, Poses
from service.workers.restoring import check_state

MIXTURE = Mixture(
    Poses(np.array([[1.0, 0, 0, 0]]), np.full((1, 2), 50.0), np.zeros(1), np.zeros((1, 1))),
    np.zeros((1, 7)),
    np.eye(14)[None],
    np.array([[0.0, 0.0, -1.0]]),
    np.zeros(1),
    np.array([0.0, 0.9, 0.1]),
    np.array([1.2, 0.0]),
    0.04,
    8.0,
    40.0,
    True,
    3,
    1,
)


def state(mixture: Mixture) -> FilterState:
    poses = Poses(np.array([[1.0, 0, 0, 0]]), np.full((1, 2), 50.0), np.zeros(1), np.zeros((1, 1)))
    return FilterState(poses, np.zeros(1), np.zeros((1, 7)), 4, 0.4, "tracking", {}, mixture)


def test_modes_as_the_filter_keeps_them_are_taken():
    check_state(state(MIXTURE), 1, 1)


@pytest.mark.parametrize(
    "broken",
    [
        {"rates": np.zeros((1, 6))},
        {"rates": np.full((1, 7), np.nan)},
        {"covariance": np.zeros((1, 14, 14))},
        {"covariance": -np.eye(14)[None]},
        {"suns": np.array([[0.0, 0.0, -2.0]])},
        {"log_weights": np.array([-3.0])},
        {"existence": np.array([-0.5, 1.0, 0.5])},
        {"existence": np.array([0.5, 0.9, 0.1])},
        {"point_spread": np.array([0.0, 0.0])},
        {"point_spread": np.array([1.0, -1.0])},
        {"discrepancy": 0.0},
        {"discrepancy": float("nan")},
        {"log_light": float("inf")},
        {"span_px": 0.0},
        {"span_px": 1e9},
        {"searches": -1},
        {"since_search": 0.5},
        {"ever_tracked": 1},
    ],
)
def test_modes_that_are_none_are_refused(broken):
    with pytest.raises(ValueError, match="mixture"):
        check_state(state(replace(MIXTURE, **broken)), 1, 1)
