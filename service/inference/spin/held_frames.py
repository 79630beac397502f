"""Frames that spacecraft are held in: by the orbit, by the Sun, by both. (n, 3, 3) rotations frame -> GCRF."""

from __future__ import annotations

import numpy as np

from service.inference.state import Array


def nadir_frames(place: Array, velocity: Array) -> Array:
    """Of places and velocities (n, 3) in GCRF: x along the orbit, y against its normal, z to the Earth's centre.

    The local vertical, local horizontal frame of operators (LVLH, z to nadir).
    """
    z = _unit(-place)
    y = _unit(-np.cross(place, velocity))
    return np.stack([np.cross(y, z), y, z], axis=-1)


def yaw_steering_frames(place: Array, sun: Array) -> Array:
    """z to the Earth's centre, y across the directions ``sun`` (n, 3), so that panels that turn about y can face it."""
    z = _unit(-place)
    y = _unit(np.cross(z, sun))
    return np.stack([np.cross(y, z), y, z], axis=-1)


def sun_frames(sun: Array) -> Array:
    """z along ``sun`` (n, 3), y across the pole."""
    z = _unit(sun)
    y = _unit(np.cross(z, np.array([0.0, 0.0, 1.0])))
    return np.stack([np.cross(y, z), y, z], axis=-1)


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
