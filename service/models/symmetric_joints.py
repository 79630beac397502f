"""What symmetries do to joints: panels that turn the other way in the mirror, or look the same after half a turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from service.inference.articulation import Joint, stage_motion
from service.inference.state import Array
from service.inference.symmetry import Symmetry
from service.models.joint_fields import FULL_TURN_DEG
from service.models.symmetry_group import make_symmetry, nearest_turn, reachable, same_value
from service.models.symmetry_matrices import ALIKE_DEG, FOLDS
from service.models.symmetry_trials import JOINT_OVERLAP, Trials

_SURE_OVERLAP = 0.985  # no need to try the other sign
_LEAST_REACH = 0.98  # a twin that lies outside the joint's range is no pose of the body
_QUERY_POINTS = 250
_TREE_POINTS = 2500


@dataclass(frozen=True)
class JointTwins:
    """Values of joints that look the same: as symmetries with an identity matrix, and as periods."""

    symmetries: tuple[Symmetry, ...]
    periods: tuple[float | None, ...]
    warnings: tuple[str, ...]


def joint_twins(trials: Trials) -> JointTwins:
    """Find the turns of each joint that its parts do not show."""
    symmetries: list[Symmetry] = []
    periods: list[float | None] = []
    warnings: list[str] = []
    for j, joint in enumerate(trials.articulation.joints):
        found = [(fold, s) for fold in FOLDS if (s := _turned_joint(trials, j, fold)) is not None]
        alone = [fold for fold, s in found if _moves_only(s, j)]
        period = min([joint.period or np.inf, *(FULL_TURN_DEG / fold for fold in alone)])
        periods.append(float(period) if period <= joint.maximum - joint.minimum else joint.period)
        symmetries += [s for _, s in found if reachable(joint, 1, s.joint_shift[j]) >= _LEAST_REACH]
        if max(alone, default=0) == max(FOLDS) and _turned_joint(trials, j, max(FOLDS) - 1) is not None:
            warnings.append(f"joint {joint.name!r} moves nothing that a silhouette shows: its value cannot be found")
    return JointTwins(tuple(symmetries), tuple(periods), tuple(warnings))


def extend(trials: Trials, matrix: Array, offset: Array, image: Array) -> Symmetry | None:
    """A symmetry that takes the joints at rest to ``image`` (J,), for as many joints off rest as it holds for.

    A value v goes to image + sign (v - rest). A revolute joint about an axis a is mapped to one about
    det(S) S a: S Rot(a, v) S^-1 = Rot(det(S) S a, v). None if it does not hold.
    """
    joints, rest = trials.articulation.joints, trials.rest
    signs = np.zeros(len(joints))
    for j, joint in enumerate(joints):
        signs[j] = _sign(trials, j, matrix, offset, image)
        if signs[j] == 0 and not same_value(joint, image[j], rest[j]):
            return None
    for tried in (signs, np.zeros(len(joints))):
        free = tried != 0
        if any(not same_value(jt, image[j], rest[j]) for j, jt in enumerate(joints) if not free[j]):
            return None
        shifts = [nearest_turn(jt, tried[j], image[j] - tried[j] * rest[j]) for j, jt in enumerate(joints)]
        symmetry = make_symmetry(matrix, offset, [float(s) for s in tried], shifts)
        if not joints or trials.holds(symmetry):
            return symmetry
    return None


def mirrored_rest(trials: Trials, matrix: Array) -> tuple[Array, Array] | None:
    """Where ``matrix`` takes the joints of a body that is symmetric but for its joints: offset (3,) and image (J,).

    The parts that no joint moves give the offset; each joint is turned until its parts lie on their own image.
    None if the body has no still part, one that lacks the symmetry, or joints that move each other.
    """
    joints = trials.articulation.joints
    moved = [trials.moved_by(joint) for joint in joints]
    flat = [p for parts in moved for p in parts]
    still = tuple(p for p in range(len(trials.mesh.parts)) if p not in flat)
    if not still or len(set(flat)) < len(flat) or not all(_keeps_axes(joint, matrix) for joint in joints):
        return None
    found = trials.offset(matrix, still)
    if found is None:
        return None
    offset = found[0]
    image = [_image(trials, joint, parts, matrix, offset) for joint, parts in zip(joints, moved, strict=True)]
    return offset, np.array(image)


def _keeps_axes(joint: Joint, matrix: Array) -> bool:
    """Whether each axis of a joint is mapped to one of its axes, whichever way that points."""
    axes = np.array([stage.axis for stage in joint.stages])
    return bool(np.all(np.abs(axes @ matrix.T @ axes.T).max(axis=1) > np.cos(np.deg2rad(ALIKE_DEG))))


def _turned_joint(trials: Trials, j: int, fold: int) -> Symmetry | None:
    """The symmetry that turns joint ``j`` by a ``fold``-th of a turn, if there is one."""
    joints, rest = trials.articulation.joints, trials.rest
    if joints[j].kind != "revolute":
        return None
    image = rest.copy()
    image[j] += FULL_TURN_DEG / fold
    if _joint_overlap(trials, j, np.eye(3), np.zeros(3), image, 1.0) < JOINT_OVERLAP:
        return None
    symmetry = extend(trials, np.eye(3), np.zeros(3), image)
    return symmetry if symmetry is not None and symmetry.joint_sign[j] == 1 else None


def _sign(trials: Trials, j: int, matrix: Array, offset: Array, image: Array) -> float:
    """1 or -1, as joint ``j`` turns under the symmetry; 0 if it holds for neither."""
    joint = trials.articulation.joints[j]
    if np.allclose(matrix, np.eye(3)) and _undisturbed(trials, j, image):
        return 1.0
    axis = np.asarray(joint.stages[0].axis)
    turned = matrix @ axis * (np.linalg.det(matrix) if joint.kind == "revolute" else 1.0)
    likely = 1.0 if turned @ axis >= 0 else -1.0
    best, best_sign = JOINT_OVERLAP, 0.0
    for sign in (likely, -likely):
        if reachable(joint, sign, nearest_turn(joint, sign, image[j] - sign * trials.rest[j])) < _LEAST_REACH:
            continue
        found = _joint_overlap(trials, j, matrix, offset, image, sign)
        if found > best:
            best, best_sign = found, sign
        if found > _SURE_OVERLAP:
            break
    return best_sign


def _joint_overlap(trials: Trials, j: int, matrix: Array, offset: Array, image: Array, sign: float) -> float:
    """How alike the parts of joint ``j`` look, the other joints at rest before and at ``image`` after."""
    signs, shifts = np.zeros(len(image)), image.copy()
    signs[j], shifts[j] = sign, image[j] - sign * trials.rest[j]
    return trials.joint_overlap(j, make_symmetry(matrix, offset, [float(s) for s in signs], [float(s) for s in shifts]))


def _undisturbed(trials: Trials, j: int, image: Array) -> bool:
    """Whether no part of joint ``j`` is moved by a joint that ``image`` takes off rest."""
    joints = trials.articulation.joints
    mine = set(trials.moved_by(joints[j]))
    changed = [k for k, joint in enumerate(joints) if not same_value(joint, image[k], trials.rest[k])]
    return j not in changed and not any(mine & set(trials.moved_by(joints[k])) for k in changed)


def _moves_only(symmetry: Symmetry, j: int) -> bool:
    others = [k for k in range(len(symmetry.joint_sign)) if k != j]
    return all(symmetry.joint_sign[k] == 1 and symmetry.joint_shift[k] == 0 for k in others)


def _image(trials: Trials, joint: Joint, parts: Sequence[int], matrix: Array, offset: Array) -> float:
    """The value at which the joint's parts lie nearest to where the symmetry takes them from rest."""
    points = np.vstack([trials.points[p] for p in parts])
    owner = np.repeat([trials.mesh.parts[p].name for p in parts], [len(trials.points[p]) for p in parts])
    start = joint.initial
    many = slice(None, None, max(1, len(points) // _TREE_POINTS))
    few = slice(None, None, max(1, len(points) // _QUERY_POINTS))
    tree = cKDTree(_moved(joint, points[many], owner[many], start) @ matrix.T + offset)

    def misfit(value: float) -> float:
        distance, _ = tree.query(_moved(joint, points[few], owner[few], value))
        return float(np.mean(distance))

    span = FULL_TURN_DEG if joint.kind == "revolute" else joint.maximum - joint.minimum
    low = start if joint.kind == "revolute" else joint.minimum
    grid = low + span * np.arange(73) / 72
    best = float(min(grid, key=misfit))
    for width in (span / 72, span / 720):
        best = float(min(best + width * np.linspace(-1, 1, 11), key=misfit))
    return start if same_value(joint, best, start) else best


def _moved(joint: Joint, points: Array, owner: NDArray[np.str_], value: float) -> Array:
    """Points (N, 3) of the parts named in ``owner`` (N,), with the joint at ``value``."""
    out = points.copy()
    for stage in sorted(joint.stages, key=lambda stage: -stage.depth):
        motion = stage_motion(stage, np.array([value]))[0]
        mine = np.isin(owner, stage.parts)
        out[mine] = out[mine] @ motion[:3, :3].T + motion[:3, 3]
    return out
