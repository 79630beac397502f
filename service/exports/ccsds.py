"""CCSDS Attitude Data Messages 2.0 (CCSDS 504.0-B-2) in KVN: the ephemeris message AEM, the parameter message APM.

The quaternion is that of the rotation from REF_FRAME_A to REF_FRAME_B, elements Q1 Q2 Q3 QC, the scalar last.
With A = GCRF and B = the body this is the quaternion body -> GCRF of coordinates.
"""

from __future__ import annotations

from datetime import UTC, datetime
from itertools import groupby

from service.exports.history import AttitudeHistory, Sample, Segment, rates_known

BODY = "SC_BODY_1"
INERTIAL = "GCRF"
_ORIGINATOR = "SKYPOSE"
_SPREADS = "Standard deviations about the body axes X, Y, Z in degrees, by epoch:"


def write_aem(history: AttitudeHistory) -> str:
    """An AEM with a segment for each uninterrupted stretch, and for what in it has no rate: rows must look alike."""
    lines = head("AEM", history)
    for stretch in history.segments:
        for _, samples in groupby(stretch, lambda sample: sample.rate_deg_s is None):
            lines += ["", *_segment(history, tuple(samples))]
    return "\n".join(lines) + "\n"


def write_apm(history: AttitudeHistory) -> str:
    """An APM of the newest attitude."""
    sample = history.segments[-1][-1]
    x, y, z = (number(value) for value in sample.quaternion[1:])
    frames = [f"REF_FRAME_A = {INERTIAL}", f"REF_FRAME_B = {BODY}"]
    lines = [
        *head("APM", history),
        *("", *_object(history), "TIME_SYSTEM = UTC", ""),
        f"EPOCH = {epoch_text(sample.time)}",
        *("QUAT_START", *frames, f"Q1 = {x}", f"Q2 = {y}", f"Q3 = {z}"),
        *(f"QC = {number(sample.quaternion[0])}", "QUAT_STOP"),
    ]
    if sample.rate_deg_s is not None:
        rates = (f"ANGVEL_{axis} = {number(value)}" for axis, value in zip("XYZ", sample.rate_deg_s, strict=True))
        lines += ["ANGVEL_START", *frames, f"ANGVEL_FRAME = {BODY}", *rates, "ANGVEL_STOP"]
    return "\n".join(lines) + "\n"


def head(kind: str, history: AttitudeHistory) -> list[str]:
    """The first lines of a message."""
    return [
        f"CCSDS_{kind}_VERS = 2.0",
        f"CREATION_DATE = {epoch_text(history.created)}",
        f"ORIGINATOR = {_ORIGINATOR}",
    ]


def _object(history: AttitudeHistory) -> list[str]:
    return [f"OBJECT_NAME = {history.name}", f"OBJECT_ID = {history.object_id}", "CENTER_NAME = EARTH"]


def _segment(history: AttitudeHistory, segment: Segment) -> list[str]:
    with_rates = rates_known(segment)
    return [
        "META_START",
        *_object(history),
        f"REF_FRAME_A = {INERTIAL}",
        f"REF_FRAME_B = {BODY}",
        "TIME_SYSTEM = UTC",
        f"START_TIME = {epoch_text(segment[0].time)}",
        f"STOP_TIME = {epoch_text(segment[-1].time)}",
        *(["ATTITUDE_TYPE = QUATERNION/ANGVEL", f"ANGVEL_FRAME = {BODY}"] if with_rates else []),
        *([] if with_rates else ["ATTITUDE_TYPE = QUATERNION"]),
        "META_STOP",
        "DATA_START",
        *_spreads(segment),
        *(_row(sample) for sample in segment),
        "DATA_STOP",
    ]


def _spreads(segment: Segment) -> list[str]:
    """AEM has no columns for uncertainty, and comments only before the rows."""
    known = [(sample.time, sample.sigma_deg) for sample in segment if sample.sigma_deg is not None]
    rows = [" ".join([epoch_text(time), *(f"{value:.6f}" for value in sigma_deg)]) for time, sigma_deg in known]
    return [f"COMMENT {line}" for line in ([_SPREADS, *rows] if rows else [])]


def _row(sample: Sample) -> str:
    w, x, y, z = sample.quaternion
    values = (x, y, z, w, *(() if sample.rate_deg_s is None else sample.rate_deg_s))
    return " ".join([epoch_text(sample.time), *(number(value) for value in values)])


def number(value: float) -> str:
    """Of a quaternion or a rate."""
    return f"{value:.12f}"


def epoch_text(moment: datetime) -> str:
    """UTC, as the standard writes it."""
    return moment.astimezone(UTC).isoformat(timespec="microseconds").removesuffix("+00:00")
