"""An attitude history, as every export takes it.

Quaternions are body -> GCRF with the scalar first; rates are of the body against GCRF, in body axes. The rotation
that carries GCRF coordinates' axes onto the body's has the same quaternion, so the formats that speak of "the
rotation from the reference frame to the body frame" (CCSDS, STK) take these numbers as they are; only their order
differs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any, Literal

import numpy as np

from service.attitude.orbit import Orbit
from service.inference.articulation import Articulation
from service.inference.state import Array

PoseName = Literal["best", "mean"]
_WITHOUT_TARGET = ("no_fit", "lost", "no_target")


@dataclass(frozen=True)
class Sample:
    """The attitude at one moment."""

    time: datetime  # aware
    quaternion: Array  # (4,) w, x, y, z; body -> GCRF
    rate_deg_s: Array | None = None  # (3,) in body axes; None: not known, as in a track's first frame
    sigma_deg: Array | None = None  # (3,) standard deviations about the body's axes
    joints: Mapping[str, float] = field(default_factory=dict)  # of those that are estimated: degrees or model units


Segment = tuple[Sample, ...]


@dataclass(frozen=True)
class Body:
    """What a viewer draws: a prepared mesh as GLB below ``czml_model.ROOT``, its joints, and metres per unit."""

    glb: bytes
    articulation: Articulation
    unit_m: float


@dataclass(frozen=True)
class AttitudeHistory:
    """Uninterrupted stretches of attitude, in order of time."""

    name: str
    object_id: str
    created: datetime
    segments: tuple[Segment, ...]
    orbit: Orbit | None = None
    body: Body | None = None


def read_history(
    documents: Iterable[Mapping[str, Any]], pose: PoseName, name: str, object_id: str, created: datetime
) -> AttitudeHistory:
    """The history in a session's estimates (contract section 4).

    A segment ends where the object is lost or its attitude unknown. Of frames of the same time, or set back in
    time (a given time after a received one), the first counts: attitude formats want time to go on.
    """
    segments: list[list[Sample]] = [[]]
    newest: datetime | None = None
    for document in documents:
        sample = _sample(document, pose)
        if sample is None:
            segments.append([])
        elif newest is None or sample.time > newest:
            segments[-1].append(sample)
            newest = sample.time
    return AttitudeHistory(name, object_id, created, tuple(_continuous(segment) for segment in segments if segment))


def _sample(document: Mapping[str, Any], pose: PoseName) -> Sample | None:
    attitude = document[pose].get("attitude")
    if attitude is None or document["status"] in _WITHOUT_TARGET:
        return None
    rate, spread = attitude.get("angular_velocity_body_deg_s"), document.get("spread")
    return Sample(
        datetime.fromisoformat(document["time"]).astimezone(UTC),
        np.array([attitude["orientation"][axis] for axis in "wxyz"]),
        None if rate is None else np.array(rate),
        None if spread is None else np.sqrt(np.diag(np.array(spread["covariance"]))[:3]),
        document[pose].get("joints", {}),
    )


def _continuous(segment: list[Sample]) -> Segment:
    """Signs chosen so that neighbouring quaternions are near each other: readers interpolate their elements."""
    kept: list[Sample] = []
    for sample in segment:
        flip = bool(kept) and float(kept[-1].quaternion @ sample.quaternion) < 0
        kept.append(replace(sample, quaternion=-sample.quaternion) if flip else sample)
    return tuple(kept)


def rates_known(segment: Segment) -> bool:
    """Whether every sample has a rate: the rows of a table must look alike."""
    return all(sample.rate_deg_s is not None for sample in segment)
