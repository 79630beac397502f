"""One joint's fields: checked, with the place of a wrong one named."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.errors import JointError
from service.inference.articulation import Joint, Kind, Stage

FULL_TURN_DEG = 360.0
LARGEST_NUMBER = 1e12  # as of coordinates: its square, and its cube, are still numbers
LONGEST_NAME = 255  # characters: answers repeat a joint's name for each symmetry and estimate


def refused(field: str, problem: str) -> JointError:
    """The error for a field such as ``joints[0].axis``."""
    return JointError(f"{field}: {problem}", field=field)


def make_joint(name: str, kind: Kind, bounds: tuple[float, float, float], stages: tuple[Stage, ...]) -> Joint:
    """A joint with its period: a whole turn, if its range covers one, and all that it drives is then back as it was."""
    low, high, initial = bounds
    # Only a joint that can turn all the way round may step from one end of its range to the other.
    turns = high - low >= FULL_TURN_DEG and all(stage.ratio.is_integer() for stage in stages)
    period = FULL_TURN_DEG if kind == "revolute" and turns else None
    return Joint(name, kind, low, high, initial, stages, period)


def range_of(low: float, high: float, initial: float, where: str) -> tuple[float, float, float]:
    """``(low, high, initial)``, if they are in order. Raises ``JointError``."""
    if low > high:
        raise refused(f"{where}.min", f"{low} is above the maximum {high}")
    if not low <= initial <= high:
        raise refused(f"{where}.initial", f"{initial} is outside {low} to {high}")
    return low, high, initial


def number(entry: Mapping[str, Any], key: str, where: str, default: float | None = None) -> float:
    """A number of ``entry``, at most ``LARGEST_NUMBER`` in size. Raises ``JointError``."""
    value = entry.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise refused(f"{where}.{key}", "must be a finite number")
    if abs(value) > LARGEST_NUMBER:
        raise refused(f"{where}.{key}", f"must be from {-LARGEST_NUMBER:g} to {LARGEST_NUMBER:g}")
    return float(value)


def vector(
    entry: Mapping[str, Any], key: str, where: str, default: tuple[float, float, float] | None = None
) -> NDArray[np.float64]:
    """(3,) finite numbers of ``entry``. Raises ``JointError``."""
    value = entry.get(key, default)
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != 3:
        raise refused(f"{where}.{key}", "must be three numbers")
    return np.array([number({key: v}, key, where) for v in value], dtype=np.float64)


def triple(vector: NDArray[np.float64]) -> tuple[float, float, float]:
    """A (3,) array as plain floats."""
    x, y, z = (float(v) for v in vector)
    return x, y, z


def require_names(joints: Sequence[Joint]) -> None:
    """Raises ``JointError`` at the second joint of one name, or at a name longer than ``LONGEST_NAME``."""
    seen: set[str] = set()
    for i, joint in enumerate(joints):
        if len(joint.name) > LONGEST_NAME:
            raise refused(f"joints[{i}].name", f"is longer than {LONGEST_NAME} characters")
        if joint.name in seen:
            raise refused(f"joints[{i}].name", f"{joint.name!r} is used twice")
        seen.add(joint.name)
