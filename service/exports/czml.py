"""CZML (Cesium): ``orientation.unitQuaternion``, body axes to Earth-fixed axes, elements X, Y, Z, W.

CZML orients bodies in Earth-fixed axes only, so GCRF is turned into ITRF at each sample's time. The packet holds no
position: it is to be merged, by its ``id``, with one that has.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import numpy as np

from service.attitude.absolute import absolute_quaternion
from service.attitude.earth import gcrf_to_itrf
from service.exports.history import AttitudeHistory, Segment


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
        },
    ]


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
