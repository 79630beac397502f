"""Symmetries as a group: compose, compare, close, and keep what holds when some joints do not move.

A joint sign of 0 says that the symmetry holds only while that joint stands at the value of its shift.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from service.inference.articulation import Articulation, Joint
from service.inference.state import Array
from service.inference.symmetry import Symmetry
from service.models.joint_fields import FULL_TURN_DEG, triple
from service.models.symmetry_matrices import ALIKE_DEG, angle_deg

MAX_ELEMENTS = 48  # with the identity: a cube has as many
FEW_ELEMENTS = 16  # numerical: of a round outline, quarters of whose turns say enough; of a body with its joints' own
_ALIKE_SHARE = 0.01  # of a joint's range, or of a turn: two values closer than this are one


def make_symmetry(matrix: Array, offset: Array, sign: Sequence[float], shift: Sequence[float]) -> Symmetry:
    """From arrays to plain numbers."""
    a, b, c = (triple(row) for row in np.asarray(matrix) + 0.0)
    return Symmetry(
        (a, b, c), triple(np.asarray(offset) + 0.0), tuple(float(s) for s in sign), tuple(float(s) for s in shift)
    )


def identity(n_joints: int) -> Symmetry:
    """The body as it is."""
    return make_symmetry(np.eye(3), np.zeros(3), (1.0,) * n_joints, (0.0,) * n_joints)


def compose(second: Symmetry, first: Symmetry, joints: Sequence[Joint]) -> Symmetry | None:
    """``first``, then ``second``; None if no joint values allow both."""
    matrix, offset = np.asarray(second.matrix), np.asarray(second.offset)
    signs, shifts = [], []
    for j, joint in enumerate(joints):
        sign, shift = first.joint_sign[j], first.joint_shift[j]
        if second.joint_sign[j] == 0 and sign != 0:
            # The first must bring the joint where the second wants it, and no other symmetry may be needed there.
            wanted = second.joint_shift[j]
            if not same_value(joint, sign * wanted + shift, wanted):
                return None
            sign, shift = 0.0, wanted
        elif sign == 0:
            if not same_value(joint, second.joint_sign[j] * shift + second.joint_shift[j], shift):
                return None
        else:
            sign, shift = second.joint_sign[j] * sign, second.joint_sign[j] * shift + second.joint_shift[j]
        signs.append(sign)
        shifts.append(nearest_turn(joint, sign, shift))
    return make_symmetry(matrix @ np.asarray(first.matrix), matrix @ np.asarray(first.offset) + offset, signs, shifts)


def implied(element: Symmetry, other: Symmetry, joints: Sequence[Joint]) -> bool:
    """Whether ``other`` says all that ``element`` says, within what a silhouette can tell. Compares no offsets."""
    for j, joint in enumerate(joints):
        sign, shift = element.joint_sign[j], element.joint_shift[j]
        there = other.joint_sign[j] * shift + other.joint_shift[j] if sign == 0 else other.joint_shift[j]
        if (sign != 0 and other.joint_sign[j] != sign) or not same_value(joint, there, shift):
            return False
    return angle_deg(np.asarray(element.matrix), np.asarray(other.matrix)) < ALIKE_DEG


def same_value(joint: Joint, a: float, b: float) -> bool:
    """Whether two values of a joint are one, whole turns apart or not."""
    gap = a - b
    if joint.kind == "revolute":
        return abs(gap - FULL_TURN_DEG * round(gap / FULL_TURN_DEG)) <= _ALIKE_SHARE * FULL_TURN_DEG
    return abs(gap) <= _ALIKE_SHARE * max(joint.maximum - joint.minimum, 1e-9)


def reachable(joint: Joint, sign: float, shift: float) -> float:
    """Share of a joint's range that ``sign * value + shift`` leaves inside the range."""
    if joint.kind == "revolute" and joint.maximum - joint.minimum >= FULL_TURN_DEG:
        return 1.0
    values = np.linspace(joint.minimum, joint.maximum, 101)
    moved = sign * values + shift
    slack = 1e-6 * max(1.0, joint.maximum - joint.minimum)
    return float(np.mean((moved >= joint.minimum - slack) & (moved <= joint.maximum + slack)))


def nearest_turn(joint: Joint, sign: float, shift: float) -> float:
    """``shift`` by whole turns, such that most of the joint's range stays in range, and small."""
    if joint.kind != "revolute" or sign == 0:
        return shift
    small = shift - FULL_TURN_DEG * np.ceil(shift / FULL_TURN_DEG - 0.5)
    turns = (0.0, FULL_TURN_DEG, -FULL_TURN_DEG)
    return float(small + max(turns, key=lambda turn: reachable(joint, sign, small + turn)))


def close_group(generators: Sequence[Symmetry], joints: Sequence[Joint]) -> tuple[Symmetry, ...]:
    """All compositions of the generators but the identity, as long as there are at most ``MAX_ELEMENTS``.

    A generator, in the given order, that would make the group larger is left out: what is kept stays a group.
    """
    group = [identity(len(joints))]
    for generator in generators:
        larger = extended(group, generator, joints, MAX_ELEMENTS)
        group = group if larger is None else larger
    return tuple(group[1:])


def with_joint_twins(
    bodies: Sequence[Symmetry], twins: Sequence[Symmetry], joints: Sequence[Joint]
) -> tuple[Symmetry, ...]:
    """A group of symmetries that move the body, and those that turn joints only: composed, if they are few enough.

    Otherwise the joints' own are listed one by one, because none of them may be lost to the limit.
    """
    alone = close_group(bodies, joints)
    together = [identity(len(joints)), *alone]
    for twin in twins:
        larger = extended(together, twin, joints, FEW_ELEMENTS)
        if larger is None:
            return (*alone, *twins)
        together = larger
    return tuple(together[1:])


def extended(
    group: Sequence[Symmetry], generator: Symmetry, joints: Sequence[Joint], limit: int
) -> list[Symmetry] | None:
    """The closure of ``group`` and one more element, or None if it has more than ``limit``."""
    if contains(group, generator, joints):
        return [*group]
    closed = [*group, generator]
    done = 0
    while done < len(closed):
        newest = closed[done]
        for other in list(closed):
            for product in (compose(newest, other, joints), compose(other, newest, joints)):
                if product is not None and not contains(closed, product, joints):
                    closed.append(product)
                    if len(closed) > limit:
                        return None
        done += 1
    return closed


def contains(group: Sequence[Symmetry], element: Symmetry, joints: Sequence[Joint]) -> bool:
    """Whether an element is in a group, within what a silhouette can tell."""
    return any(implied(element, other, joints) for other in group)


def held_symmetries(
    symmetries: Sequence[Symmetry], articulation: Articulation, held: Articulation
) -> tuple[Symmetry, ...]:
    """The symmetries of a session: of the whole ``articulation``, those that its ``held`` form allows.

    ``held`` is ``inference.articulation.hold`` of the same articulation. The result has one sign and shift per
    joint that is estimated. A symmetry stays if it leaves every held joint where it is and moves the others freely.
    """
    values = {joint.name: value for joint, value in held.held}
    free = [j for j, joint in enumerate(articulation.joints) if joint.name not in values]
    found: list[Symmetry] = []
    for symmetry in symmetries:
        stays = all(
            same_value(joint, symmetry.joint_sign[j] * values[joint.name] + symmetry.joint_shift[j], values[joint.name])
            for j, joint in enumerate(articulation.joints)
            if joint.name in values
        )
        if stays and all(symmetry.joint_sign[j] != 0 for j in free):
            found.append(
                make_symmetry(
                    np.asarray(symmetry.matrix),
                    np.asarray(symmetry.offset),
                    [symmetry.joint_sign[j] for j in free],
                    [symmetry.joint_shift[j] for j in free],
                )
            )
    joints = [articulation.joints[j] for j in free]
    found = [s for s in found if not implied(s, identity(len(free)), joints)]
    bodies = [s for s in found if s.kind != "joint"]
    return with_joint_twins(bodies, [s for s in found if s.kind == "joint"], joints)
