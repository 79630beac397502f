"""The export formats by name."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any

from service.attitude.orbit import Orbit
from service.errors import ConflictError
from service.exports.acm import write_acm
from service.exports.ccsds import write_aem, write_apm
from service.exports.czml import czml_packets
from service.exports.history import AttitudeHistory, Body, PoseName, read_history
from service.exports.stk import write_stk
from service.exports.tables import write_csv, write_npz


@dataclass(frozen=True)
class Subject:
    """What is exported: a session's object."""

    name: str
    object_id: str
    joints: Mapping[str, str]  # name of each estimated joint -> its unit: deg, or units of the model
    created: datetime
    orbit: str | None = None  # elements, where they were told
    body: Body | None = None  # where it is asked for


@dataclass(frozen=True)
class ExportFormat:
    """How a format is called elsewhere."""

    media_type: str
    suffix: str


def _czml(history: AttitudeHistory) -> str:
    return json.dumps(czml_packets(history), separators=(",", ":"))


FORMATS: Mapping[str, ExportFormat] = {
    "aem": ExportFormat("text/plain", "aem"),
    "acm": ExportFormat("text/plain", "acm"),
    "apm": ExportFormat("text/plain", "apm"),
    "stk": ExportFormat("text/plain", "a"),
    "czml": ExportFormat("application/json", "czml"),
    "csv": ExportFormat("text/csv", "csv"),
    "npz": ExportFormat("application/x-npz", "npz"),
}
_ATTITUDE: Mapping[str, Callable[[AttitudeHistory], str]] = {
    "aem": write_aem,
    "acm": write_acm,
    "apm": write_apm,
    "stk": write_stk,
    "czml": _czml,
}


def export(name: str, estimates: Sequence[Mapping[str, Any]], pose: PoseName, subject: Subject) -> bytes:
    """The history of ``estimates`` in one of ``FORMATS``.

    Raises ``ConflictError`` where the format needs an absolute attitude and no frame has one.
    """
    if name == "npz":
        return write_npz(estimates, subject.joints, pose)
    if name == "csv":
        return write_csv(estimates, subject.joints, pose).encode()
    history = read_history(estimates, pose, _line(subject.name), _line(subject.object_id), subject.created)
    if not history.segments:
        raise ConflictError(
            "no tracked frame has an absolute attitude: frames need a pointing (ra_deg and dec_deg, or az_deg and "
            "el_deg, or a FITS header that has them) and the rotation of the camera",
            field="query:format",
        )
    orbit = None if subject.orbit is None else Orbit(subject.orbit)
    history = replace(history, orbit=orbit, body=subject.body)
    return _ATTITUDE[name](history).encode()


def _line(text: str) -> str:
    """One line of printable ASCII, as the text formats demand: a name must not bring keywords of its own."""
    line = "".join(char if char.isascii() and char.isprintable() else " " for char in text)
    return " ".join(line.split()) or "UNKNOWN"
