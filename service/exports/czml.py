"""CZML (Cesium): ``orientation.unitQuaternion``, body axes to Earth-fixed axes, elements X, Y, Z, W.

CZML orients bodies in Earth-fixed axes only, so GCRF is turned into ITRF at each sample's time. Where the orbit is
known the packet has the position too, as a point with its name; else it is to be merged, by its ``id``, with one that
has.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import numpy as np

from service.attitude.absolute import absolute_quaternion
from service.attitude.earth import gcrf_to_itrf
from service.attitude.orbit import Orbit
from service.exports.czml_model import model_properties
from service.exports.history import AttitudeHistory, Segment

_DEGREE = 5  # of the interpolation between positions: an orbit's arc of a second to a millimetre
_BESIDE = {"cartesian2": [0, -20]}


def czml_packets(history: AttitudeHistory) -> list[dict[str, Any]]:
    """The document as JSON data."""
    whole = f"{_text(history.segments[0][0].time)}/{_text(history.segments[-1][-1].time)}"
    clock = {"interval": whole, "currentTime": _text(history.segments[0][0].time), "multiplier": 1}
    return [
        {"id": "document", "name": history.name, "version": "1.0", "clock": clock},
        {
            "id": history.object_id,
            "name": history.name,
            "availability": [_interval(segment) for segment in history.segments],
            "orientation": [_orientation(segment) for segment in history.segments],
            **({} if history.orbit is None else _place(history, history.orbit)),
            **({} if history.body is None else {"model": model_properties(history.body, history.segments)}),
        },
    ]


def _place(history: AttitudeHistory, orbit: Orbit) -> dict[str, Any]:
    """Metres in Earth-fixed axes, at the samples' times."""
    moments = [sample.time for segment in history.segments for sample in segment]
    values: list[float] = []
    for moment in moments:
        values += [(moment - moments[0]).total_seconds(), *(1e3 * orbit.fixed_km(moment)).tolist()]
    position = {
        "epoch": _text(moments[0]),
        "interpolationAlgorithm": "LAGRANGE",
        "interpolationDegree": min(_DEGREE, max(len(moments) - 1, 1)),
        "cartesian": values if len(moments) > 1 else values[1:],
    }
    return {"position": position, "point": {"pixelSize": 8}, "label": {"text": history.name, "pixelOffset": _BESIDE}}


def _orientation(segment: Segment) -> dict[str, Any]:
    epoch = segment[0].time
    values: list[float] = []
    last = np.zeros(4)
    for sample in segment:
        fixed = absolute_quaternion(gcrf_to_itrf(sample.time), sample.quaternion)
        last = -fixed if last @ fixed < 0 else fixed
        w, x, y, z = last.tolist()
        values += [(sample.time - epoch).total_seconds(), x, y, z, w]
    return {
        "interval": _interval(segment),
        "epoch": _text(epoch),
        "interpolationAlgorithm": "LINEAR",
        "interpolationDegree": 1,
        "unitQuaternion": values if len(segment) > 1 else values[1:],
    }


def _interval(segment: Segment) -> str:
    return f"{_text(segment[0].time)}/{_text(segment[-1].time)}"


def _text(moment: datetime) -> str:
    return moment.astimezone(UTC).isoformat(timespec="microseconds").removesuffix("+00:00") + "Z"
