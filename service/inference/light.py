"""What is known of the light on the object before a frame is looked at."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Light:
    """Light at one frame; None is unknown.

    Directions are unit vectors in camera axes: x right, y down, z away from the camera. That is so of a mirrored image
    too (``mirrored``), in whose poses z comes towards the observer: there the sign of z is the other one.
    """

    towards_sun: Vector | None = None
    sigma_rad: float | None = None  # standard deviation of that direction, about each axis across it
    sunlit: float | None = None  # share of the Sun's disc that the Earth leaves free, 0 (umbra) to 1
    earth: Vector | None = None  # from the object to the Earth's centre
    earthshine: float | None = None  # expected, as a share of the Sun's own light outside of the shadow
    earth_aside: float | None = None  # of that, what comes to a face that is turned across the Earth
    mirrored: bool = False


def unit(vector: Sequence[float]) -> Vector:
    """A vector of any length as one of length 1. Raises ``ValueError`` for zero, NaN, infinity and other dimensions."""
    if len(vector) != 3:
        raise ValueError("must have three components")
    if not all(math.isfinite(part) for part in vector):
        raise ValueError("must be finite")
    longest = max(abs(part) for part in vector)
    if longest == 0:
        raise ValueError("must not be zero")
    x, y, z = (part / longest for part in vector)  # else the square of a very long or short one is lost
    length = math.hypot(x, y, z)
    return (x / length, y / length, z / length)
