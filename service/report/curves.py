"""What changes over a pass, as charts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
from markupsafe import Markup

from service.inference.pose import rotation_matrices
from service.inference.state import Array
from service.report.charts import Line, chart

_AXES = (("x", "#b2182b"), ("y", "#1b7837"), ("z", "#2166ac"))
_COLOURS = ("#2166ac", "#b2182b", "#1b7837", "#762a83", "#bf812d", "#4d4d4d")
_UNSEEN = ("no_target", "no_fit", "lost")

Estimates = Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class Chart:
    """A chart with its heading."""

    title: str
    keys: tuple[tuple[str, str], ...]  # colour and name of each curve
    picture: Markup


def charts(estimates: Estimates) -> list[Chart]:
    """Those of which something is known, in the order in which they are read."""
    seconds = seconds_of(estimates)
    seen = np.array([estimate["status"] not in _UNSEEN for estimate in estimates])
    return [
        *_attitude(seconds, seen, estimates),
        *_joints(seconds, seen, estimates),
        _trust(seconds, seen, estimates),
        *_hypotheses(seconds, estimates),
    ]


def seconds_of(estimates: Estimates) -> Array:
    """(N,) from the first frame."""
    times = [datetime.fromisoformat(estimate["time"]) for estimate in estimates]
    return np.array([(time - times[0]).total_seconds() for time in times])


def on_sphere_deg(vectors: Array) -> Array:
    """(..., 3) vectors -> (..., 2) longitude from x towards y, 0 to 360, and latitude towards z: deg."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack([np.rad2deg(np.arctan2(y, x)) % 360, np.rad2deg(np.arctan2(z, np.hypot(x, y)))], axis=-1)


def absolute(estimates: Estimates) -> bool:
    """Whether the attitude among the stars is known in any frame."""
    return any(estimate["best"].get("attitude") is not None for estimate in estimates)


def _attitude(seconds: Array, seen: Array, estimates: Estimates) -> list[Chart]:
    """Where the body's axes point: right ascension and declination, or against the camera's axes."""
    stars = absolute(estimates)
    given = [estimate["best"].get("attitude") if stars else estimate["best"] for estimate in estimates]
    rotation = np.full((len(estimates), 3, 3), np.nan)
    for k, pose in enumerate(given):
        if pose is not None and seen[k]:
            rotation[k] = rotation_matrices(np.array([pose["orientation"][name] for name in "wxyz"]))
    variances = np.array([np.diag(np.array(estimate["spread"]["covariance"]))[:3] for estimate in estimates])
    around, up = [], []
    for k, (name, colour) in enumerate(_AXES):
        place = on_sphere_deg(rotation[:, :, k])
        sigma = np.sqrt(0.5 * (variances.sum(axis=1) - variances[:, k]))
        around.append(Line(name, colour, place[:, 0], sigma / np.maximum(np.cos(np.deg2rad(place[:, 1])), 0.02)))
        up.append(Line(name, colour, place[:, 1], sigma))
    names = ("Right ascension", "Declination") if stars else ("Turn in the image, from right to down", "Away from us")
    return [
        _chart(f"{names[0]} of the body’s axes, deg", seconds, around, wraps=360.0),
        _chart(f"{names[1]} of the body’s axes, deg", seconds, up),
    ]


def _joints(seconds: Array, seen: Array, estimates: Estimates) -> list[Chart]:
    names = list(estimates[0]["best"]["joints"])
    spread = [estimate["spread"]["joints"] for estimate in estimates]
    free = [name for name in names if name in spread[0]]
    if not free:
        return []
    lines = []
    for k, name in enumerate(free):
        values = np.array([estimate["best"]["joints"][name] for estimate in estimates], dtype=np.float64)
        sigma = np.array([one[name] for one in spread], dtype=np.float64)
        lines.append(Line(name, _COLOURS[k % len(_COLOURS)], np.where(seen, values, np.nan), sigma))
    return [_chart("Joints, deg or units of the model", seconds, lines)]


def _trust(seconds: Array, seen: Array, estimates: Estimates) -> Chart:
    own = np.array([estimate["spread"]["orientation_deg"] for estimate in estimates])
    lines = [Line("of the best mode", _COLOURS[0], np.where(seen, own, np.nan))]
    if all(estimate.get("spread_all") is not None for estimate in estimates):
        whole = np.array([estimate["spread_all"]["orientation_deg"] for estimate in estimates])
        lines.append(Line("of all modes", _COLOURS[5], np.where(seen, whole, np.nan)))
    top = max(float(np.nanmax(line.values, initial=0.0)) for line in lines)
    return _chart("Stated standard deviation of the orientation, deg", seconds, lines, (0.0, 1.05 * top or 1.0))


def _hypotheses(seconds: Array, estimates: Estimates) -> list[Chart]:
    if any(estimate.get("probabilities") is None for estimate in estimates):
        return []
    names = (
        ("fits", "this body", "#2166ac"),
        ("no_fit", "something else", "#b2182b"),
        ("absent", "nothing", "#4d4d4d"),
    )
    lines = [
        Line(says, colour, np.array([estimate["probabilities"][name] for estimate in estimates]))
        for name, says, colour in names
    ]
    lead = np.array([max((mode["weight"] for mode in estimate["modes"]), default=np.nan) for estimate in estimates])
    lines.append(Line("share of the best mode", "#bf812d", lead))
    return [_chart("Probability of what each frame shows", seconds, lines, (0.0, 1.0))]


def _chart(
    title: str,
    seconds: Array,
    lines: Sequence[Line],
    limits: tuple[float, float] | None = None,
    wraps: float = np.inf,
) -> Chart:
    keys = tuple((line.colour, line.name) for line in lines)
    return Chart(title, keys, chart(f"{title}, over seconds", seconds, lines, limits, wraps))
