"""The estimate's JSON: finite or refused."""

from dataclasses import replace
from decimal import Decimal

import numpy as np
import orjson
import pytest

from service.errors import SkyposeError
from service.inference.state import Estimate, Mode, PoseEstimate, Spread
from service.sessions.document import JointNames, as_duplicate, decimal_shares, estimate_document
from service.workers.base import PackedFrameReport

POSE = PoseEstimate(np.array([-0.5, 0.5, 0.5, 0.5]), np.array([10.0, 20.0]), 3.0, np.array([15.0]))
SPREAD = Spread(1.0, 1.0, 1.0, 1.0, 0.5, 0.5, 0.1, np.array([2.0]), np.eye(7))
ESTIMATE = Estimate("tracking", POSE, POSE, -5.0, SPREAD, (Mode(1.0, POSE, SPREAD),), 100, 50.0, -7.0)
NAMES = JointNames(("panel",), {"boom": 3.0})


def document(estimate: Estimate) -> bytes:
    return estimate_document("s", 3, "t", NAMES, PackedFrameReport(b"", estimate, {"total": 1.23456}, "x"))


def test_orientation_has_positive_w_and_joints_have_names():
    data = orjson.loads(document(ESTIMATE))
    assert data["best"]["orientation"] == {"w": 0.5, "x": -0.5, "y": -0.5, "z": -0.5}
    assert data["best"]["joints"] == {"panel": 15.0, "boom": 3.0}
    assert data["spread"]["covariance_order"][-1] == "joint:panel"
    assert data["timing_ms"] == {"total": 1.235}


@pytest.mark.parametrize(
    "broken",
    [
        replace(ESTIMATE, log_evidence=float("nan")),
        replace(ESTIMATE, best_log_likelihood=float("-inf")),
        replace(ESTIMATE, mean=replace(POSE, position=np.array([np.nan, 0.0]))),
        replace(ESTIMATE, spread=replace(SPREAD, covariance=np.full((7, 7), np.inf))),
        replace(ESTIMATE, modes=(Mode(float("nan"), POSE, SPREAD),)),
    ],
)
def test_what_is_not_finite_never_leaves(broken):
    with pytest.raises(SkyposeError, match="not finite"):
        document(broken)


def test_duplicate_differs_in_its_mark_only():
    first = orjson.loads(document(ESTIMATE))
    assert orjson.loads(as_duplicate(document(ESTIMATE))) == {**first, "duplicate": True}


@pytest.mark.parametrize("shares", [[1 / 3] * 3, [0.7, 0.2, 0.1], [1.0], [1 - 1e-12, 1e-12], []])
def test_weights_sum_to_one_as_they_are_written(shares):
    written = orjson.dumps(decimal_shares(shares)).decode()
    found = [Decimal(text) for text in written.strip("[]").split(",") if text]
    assert sum(found) == bool(shares)
    assert [float(value) for value in found] == pytest.approx(shares, abs=1e-9)
