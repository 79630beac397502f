"""STK attitude file (``*.a``): seconds since the scenario epoch, quaternion with the scalar last, rates in body axes.

The quaternion is that of the rotation from the coordinate axes to the body axes; angular velocities are in degrees
per second along the body's axes (help.agi.com, "Attitude File Format"). STK's Earth ICRF axes are GCRF.
"""

from __future__ import annotations

from datetime import UTC, datetime

from service.exports.history import AttitudeHistory, Sample, rates_known

_MONTHS = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")  # in any locale


def write_stk(history: AttitudeHistory) -> str:
    """One table of all segments; breaks between them are told to STK as segment boundaries."""
    samples = [sample for segment in history.segments for sample in segment]
    epoch = samples[0].time
    with_rates = all(rates_known(segment) for segment in history.segments)
    breaks = [_seconds(segment[-1].time, epoch) for segment in history.segments[:-1]]
    lines = [
        "stk.v.11.0",
        "BEGIN Attitude",
        f"NumberOfAttitudePoints {len(samples)}",
        "BlockingFactor 20",
        "InterpolationOrder 1",
        "CentralBody Earth",
        f"ScenarioEpoch {_epoch(epoch)}",
        "CoordinateAxes ICRF",
        *(["SegmentBoundaryTimes", *breaks] if breaks else []),
        "AttitudeTimeQuatAngVels" if with_rates else "AttitudeTimeQuaternions",
        *(_row(sample, epoch, with_rates) for sample in samples),
        "END Attitude",
    ]
    return "\n".join(lines) + "\n"


def _row(sample: Sample, epoch: datetime, with_rates: bool) -> str:
    w, x, y, z = sample.quaternion
    rate = () if sample.rate_deg_s is None or not with_rates else tuple(sample.rate_deg_s)
    return " ".join([_seconds(sample.time, epoch), *(f"{value:.12e}" for value in (x, y, z, w, *rate))])


def _seconds(moment: datetime, epoch: datetime) -> str:
    return f"{(moment - epoch).total_seconds():.6f}"


def _epoch(moment: datetime) -> str:
    utc = moment.astimezone(UTC)
    return f"{utc.day} {_MONTHS[utc.month - 1]} {utc.year} {utc:%H:%M:%S.%f}"
