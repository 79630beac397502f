"""Eight rotations with what they do to the body's axes, written down without a quaternion library.

Each entry: scalar and vector part of the quaternion body -> GCRF, and where the body's x and y axes point in GCRF.
"""

import itertools
from datetime import UTC, datetime, timedelta

import numpy as np

from service.exports.history import AttitudeHistory, Sample

H = np.sqrt(0.5)
ROTATIONS = [
    ((1, 0, 0, 0), (1, 0, 0), (0, 1, 0)),  # none
    ((H, H, 0, 0), (1, 0, 0), (0, 0, 1)),  # 90 degrees about x
    ((H, 0, H, 0), (0, 0, -1), (0, 1, 0)),  # about y
    ((H, 0, 0, H), (0, 1, 0), (-1, 0, 0)),  # about z
    ((0, 1, 0, 0), (1, 0, 0), (0, -1, 0)),  # half a turn about x
    ((0.5, 0.5, 0.5, 0.5), (0, 1, 0), (0, 0, 1)),  # a third of a turn about (1, 1, 1)
    ((0.5, -0.5, -0.5, -0.5), (0, 0, 1), (1, 0, 0)),  # and back
    ((0.8, 0.0, 0.0, -0.6), (0.28, -0.96, 0), (0.96, 0.28, 0)),  # 73.74 degrees clockwise about z
]
START = datetime(2026, 11, 20, 3, 4, 5, 250_000, tzinfo=UTC)
RATES = [np.array([k, 0.5 * k, -0.25]) for k in range(8)]


def history(*, rates: bool = True, breaks: tuple[int, ...] = (5,)) -> AttitudeHistory:
    samples = [
        Sample(START + timedelta(seconds=k), np.array(q, float), RATES[k] if rates else None)
        for k, (q, _, _) in enumerate(ROTATIONS)
    ]
    edges = [0, *breaks, len(samples)]
    segments = tuple(tuple(samples[a:b]) for a, b in itertools.pairwise(edges))
    return AttitudeHistory("TOPEX", "1992-052A", START, segments)


def require_axes(x_axis, y_axis, index: int) -> None:
    np.testing.assert_allclose(x_axis, ROTATIONS[index][1], atol=1e-9)
    np.testing.assert_allclose(y_axis, ROTATIONS[index][2], atol=1e-9)
