"""CCSDS Attitude Comprehensive Message 2.0 (CCSDS 504.0-B-2, section 5) in KVN: attitude, rates and covariance.

Quaternions as in an AEM (``ccsds``). Times are seconds since EPOCH_TZERO, the first sample's. The covariance is of
small rotations about the body's axes; the standard writes its diagonal alone, in deg².
"""

from __future__ import annotations

from datetime import datetime
from itertools import groupby

from service.exports.ccsds import BODY, INERTIAL, epoch_text, head, number
from service.exports.history import AttitudeHistory, Sample

_BASIS = "DETERMINED_GND"


def write_acm(history: AttitudeHistory) -> str:
    """A block of attitude for each uninterrupted stretch, and for what in it has no rate; a block of covariance."""
    zero, last = history.segments[0][0].time, history.segments[-1][-1].time
    known = [any(sample.sigma_deg is not None for sample in stretch) for stretch in history.segments]
    lines = [
        *head("ACM", history),
        "",
        "META_START",
        f"OBJECT_NAME = {history.name}",
        f"INTERNATIONAL_DESIGNATOR = {history.object_id}",
        "TIME_SYSTEM = UTC",
        f"EPOCH_TZERO = {epoch_text(zero)}",
        f"ACM_DATA_ELEMENTS = {'ATT, COV' if any(known) else 'ATT'}",
        "START_TIME = 0.000000",
        f"STOP_TIME = {_seconds(zero, last)}",
        "META_STOP",
    ]
    for stretch in history.segments:
        for without_rate, samples in groupby(stretch, lambda sample: sample.rate_deg_s is None):
            lines += ["", *_attitude(zero, list(samples), rated=not without_rate)]
    for stretch in history.segments:
        lines += _covariance(zero, [sample for sample in stretch if sample.sigma_deg is not None])
    return "\n".join(lines) + "\n"


def _attitude(zero: datetime, samples: list[Sample], *, rated: bool) -> list[str]:
    return [
        "ATT_START",
        f"ATT_BASIS = {_BASIS}",
        f"REF_FRAME_A = {INERTIAL}",
        f"REF_FRAME_B = {BODY}",
        f"NUMBER_STATES = {7 if rated else 4}",
        "ATT_TYPE = QUATERNION",
        *(["RATE_TYPE = ANGVEL"] if rated else []),
        *(_row(zero, sample) for sample in samples),
        "ATT_STOP",
    ]


def _covariance(zero: datetime, samples: list[Sample]) -> list[str]:
    if not samples:
        return []
    rows = []
    for sample in samples:
        assert sample.sigma_deg is not None, "chosen by the caller"
        rows.append(" ".join([_seconds(zero, sample.time), *(f"{value**2:.9e}" for value in sample.sigma_deg)]))
    head_lines = ["", "COV_START", f"COV_BASIS = {_BASIS}", f"COV_REF_FRAME = {BODY}", "COV_TYPE = ANGLE"]
    return [*head_lines, *rows, "COV_STOP"]


def _row(zero: datetime, sample: Sample) -> str:
    w, x, y, z = sample.quaternion
    values = (x, y, z, w, *(() if sample.rate_deg_s is None else sample.rate_deg_s))
    return " ".join([_seconds(zero, sample.time), *(number(value) for value in values)])


def _seconds(zero: datetime, moment: datetime) -> str:
    return f"{(moment - zero).total_seconds():.6f}"
