"""The answer of a pass in two sentences."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from service.report.curves import on_sphere_deg

_SURE = 0.9  # probability below which it is said
SEEN_SIGMAS = 3.0
"""A change that is less is told as none."""
_MODE_NAMES = {
    "inertially_fixed": "held still among the stars",
    "nadir_pointing": "nadir-pointing",
    "yaw_steering": "nadir-pointing with yaw steering",
    "sun_pointing": "Sun-pointing",
    "spin_stabilised": "spin-stabilised",
    "tumbling": "tumbling",
}


def turning_sentence(motion: Mapping[str, Any] | None, why_not: str) -> str:
    """How the object turned; ``why_not`` where that is not known."""
    if motion is None:
        return f"How it turned is not known: {why_not}."
    rate = f"{with_sigma(motion['rate_deg_s'], motion['rate_sigma_deg_s'])} °/s"
    against = "" if motion["relative_to"] == "GCRF" else " against the camera"
    if motion["period_s"] is None:
        told = f"No turning is seen{against}: {rate}"
    else:
        verb = "It tumbled" if motion["model"] == "tumbling" else "It turned"
        period = with_sigma(motion["period_s"], motion["period_sigma_s"])
        told = f"{verb}{against} at {rate}, once in {period} s, about {_axis(motion)}"
    sure = motion["probability"]
    doubt = "" if sure >= _SURE else f"; this course of orientations has a probability of {sure:.2f} only"
    return f"{told}{doubt}."


def attitude_sentence(motion: Mapping[str, Any] | None, estimates: Sequence[Mapping[str, Any]]) -> str:
    """What holds it, or else how far the frames can be trusted."""
    mode = None if motion is None else motion["attitude_mode"]
    counts = Counter(estimate["status"] for estimate in estimates)
    followed = f"{counts['tracking']} of {len(estimates)} frames are tracked"
    if mode is None:
        last = estimates[-1]
        where = f"in the last ({last['status']}) its orientation is stated to {last['spread']['orientation_deg']:.2g}°"
        return f"{followed[0].upper()}{followed[1:]}; {where}."
    sure = mode["probabilities"][mode["mode"]]
    name = _MODE_NAMES[mode["mode"]]
    if sure < _SURE:
        return f"Its attitude mode is not decided: {name} has a probability of {sure:.2f}; {followed}."
    off = ""
    if mode["offset_deg"] is not None:
        off = f", {mode['body_axis']} {with_sigma(mode['offset_deg'], mode['sigma_deg'])}° off"
    return f"It was {name} (p {told_probability(sure)}){off}; {followed}."


def told_probability(value: float) -> str:
    """Two digits, and never a certainty."""
    return "> 0.99" if value > 0.99 else "< 0.01" if value < 0.01 else f"{value:.2f}"


def with_sigma(value: float, sigma: float) -> str:
    """A value and its standard deviation with two digits of that: 5.021 ± 0.013."""
    digits = 0
    while digits < 6 and abs(sigma) * 10**digits < 9.5:
        digits += 1
    return f"{value:.{digits}f} ± {sigma:.{digits}f}"


def _axis(motion: Mapping[str, Any]) -> str:
    if motion["axis_gcrf"] is not None:
        ra, dec = on_sphere_deg(np.array([motion["axis_gcrf"][name] for name in "xyz"]))
        return f"right ascension {ra:.1f}°, declination {dec:+.1f}° (± {motion['axis_gcrf_sigma_deg']:.1g}°)"
    axis = motion["axis_body"]
    return f"body axis ({axis['x']:+.2f}, {axis['y']:+.2f}, {axis['z']:+.2f})"
