"""Figures of a posterior and of a pass. Needs matplotlib, which only commands that draw import."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from service.api.schemas import Estimate, Joint, Pose
from service.inference.pose import conjugate, log_so3, multiply, rotation_matrices
from service.inference.state import Array
from service.remote.calls import Arrays

_AXES = {"x": "#b2182b", "y": "#1b7837", "z": "#2166ac"}
_BINS = 40
_POSE = ("rx, deg", "ry, deg", "rz, deg", "x, px", "y, px", "scale, %")


def orientation_figure(estimate: Estimate, particles: Arrays) -> Figure:
    """Where the body's axes point, on a map of equal areas (Mollweide): dots are particles, rings the best pose.

    In GCRF (right ascension to the left) where the camera's orientation is known, else in the camera's axes.
    """
    known = estimate.camera
    to_frame = np.eye(3) if known is None else rotation_matrices(_elements(known.orientation))
    figure = Figure(figsize=(9, 5.2), layout="constrained")
    panel: Any = figure.add_subplot(projection="mollweide")
    cloud = to_frame @ rotation_matrices(particles["orientation"])
    best = to_frame @ rotation_matrices(_elements(estimate.best.orientation))
    side = 1.0 if known is None else -1.0  # the sky is seen from within
    for k, (name, colour) in enumerate(_AXES.items()):
        size = 2 + 200 * particles["weights"]
        panel.scatter(*_on_map(cloud[:, :, k], side), s=size, color=colour, alpha=0.25, linewidths=0)
        longitude, latitude = _on_map(best[None, :, k], side)
        ring = {"markersize": 20, "markeredgewidth": 1.6, "markerfacecolor": "none"}  # what it is about stays in sight
        panel.plot(longitude, latitude, "o", color=colour, **ring)
        panel.annotate(
            name,
            (longitude[0], latitude[0]),
            (13, 7),
            textcoords="offset points",
            color=colour,
            fontsize=15,
            weight="bold",
        )
    panel.grid(linewidth=0.4)
    panel.set_yticks(np.deg2rad(np.arange(-60, 61, 30)))
    panel.tick_params(labelsize=8, labelcolor="#555555")
    if known is not None:
        panel.set_xticks(np.deg2rad(np.arange(-120, 121, 60)), [f"{-hours % 24} h" for hours in range(-8, 9, 4)])
    frame = "camera (x right, y down, z away: centre is x)" if known is None else "GCRF"
    spread = f"± {estimate.spread.orientation_deg:.2g}°"
    panel.set_title(
        f"frame {estimate.index}, {estimate.status}, {spread}: the body's axes in {frame}", fontsize=11, pad=14
    )
    figure.supxlabel("rings: the best pose; dots: particles", fontsize=10)
    return figure


def corner_figure(estimate: Estimate, particles: Arrays, joints: Sequence[Joint]) -> Figure:
    """Every pair of the pose's coordinates about the best pose, weighted, and each alone. ``joints``: the model's."""
    values = _about(estimate.best, particles)
    units = {joint.name: "deg" if joint.kind == "revolute" else "model units" for joint in joints}
    names = [*_POSE, *(f"{name}, {units[name]}" for name in particles["joint_names"].tolist())]
    count = len(names)
    figure = Figure(figsize=(1.7 * count, 1.7 * count), layout="constrained")
    panels: Any = figure.subplots(count, count, squeeze=False, sharex="col")
    for row in range(count):
        for column in range(count):
            panel = panels[row, column]
            if column > row:
                panel.set_axis_off()
            elif column == row:
                panel.hist(values[:, row], _BINS, weights=particles["weights"], color="#2166ac")
                panel.set_yticks([])
            else:
                bins = [_edges(values[:, column]), _edges(values[:, row])]
                panel.hist2d(values[:, column], values[:, row], bins, weights=particles["weights"], cmap="Blues")
            panel.tick_params(labelsize=6)
        panels[row, 0].set_ylabel(names[row], fontsize=8)
        panels[-1, row].set_xlabel(names[row], fontsize=8)
    figure.suptitle(f"frame {estimate.index}, {estimate.status}: {len(values)} particles about the best pose")
    return figure


def residual_figure(filtered: Sequence[Estimate], smoothed: Sequence[Estimate]) -> Figure:
    """The best pose of each frame less the one that knows all later frames too; bands: one standard deviation."""
    seconds = _seconds(filtered)
    rows = np.array([_difference(now.best, later.best) for now, later in zip(filtered, smoothed, strict=True)])
    units = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 100.0])
    variances = np.array([np.diag(np.array(one.spread.covariance))[:6] for one in filtered])
    spread = np.sqrt(variances) * units
    figure = Figure(figsize=(9, 11), layout="constrained")
    panels: list[Axes] = list(figure.subplots(len(_POSE) + 1, 1, sharex=True))
    for k, name in enumerate(_POSE):
        panels[k].fill_between(seconds, -spread[:, k], spread[:, k], color="#92c5de", alpha=0.6, linewidth=0)
        panels[k].plot(seconds, rows[:, k], ".-", color="#2166ac", linewidth=0.8, markersize=4)
        panels[k].set_ylabel(name)
    panels[-1].plot(seconds, [one.log_evidence for one in filtered], color="#4d4d4d")
    panels[-1].set_ylabel("log evidence")
    panels[-1].set_xlabel("seconds from the first frame")
    panels[0].set_title("filtered less smoothed, about the body's axes and in the image", fontsize=10)
    return figure


def _about(best: Pose, particles: Arrays) -> Array:
    """(N, 6 + J) particles less the best pose: rotation about the body's axes in degrees, pixels, per cent, joints."""
    turn = np.rad2deg(log_so3(multiply(conjugate(_elements(best.orientation)), particles["orientation"])))
    shift = particles["position_px"] - (best.x_px, best.y_px)
    growth = 100 * np.log(particles["scale_px"] / best.scale_px)
    joints = particles["joints"] - [best.joints[name] for name in particles["joint_names"].tolist()]
    return np.column_stack([turn, shift, growth, joints])


def _difference(one: Pose, other: Pose) -> list[float]:
    """(6,) of one pose less another, as in ``_about``."""
    turn = np.rad2deg(log_so3(multiply(conjugate(_elements(other.orientation)), _elements(one.orientation))))
    growth = 100 * float(np.log(one.scale_px / other.scale_px))
    return [*turn.tolist(), one.x_px - other.x_px, one.y_px - other.y_px, growth]


def _on_map(vectors: Array, side: float) -> tuple[Array, Array]:
    """Longitude and latitude in radians of unit vectors (N, 3)."""
    return side * np.arctan2(vectors[:, 1], vectors[:, 0]), np.arcsin(np.clip(vectors[:, 2], -1.0, 1.0))


def _edges(values: Array) -> Array:
    """Edges of bins, also where all values are the same."""
    return np.histogram_bin_edges(values, _BINS)


def _seconds(estimates: Sequence[Estimate]) -> list[float]:
    times = [datetime.fromisoformat(one.time) for one in estimates]
    return [(moment - times[0]).total_seconds() for moment in times]


def _elements(orientation: Any) -> Array:
    return np.array([orientation.w, orientation.x, orientation.y, orientation.z])
