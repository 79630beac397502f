"""Joints tied to one another: two panels on one drive are one variable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from service.inference.articulation import Joint, Stage
from service.models.joint_fields import make_joint, number, range_of, refused

LARGEST_RATIO = 100.0
_TIE_KEYS = {"name", "tied_to", "ratio"}


@dataclass(frozen=True)
class Tie:
    """Joint ``name`` always stands at ``ratio`` times the value of joint ``leader``."""

    name: str
    leader: str
    ratio: float
    where: str  # of the request, for errors


def split_ties(
    entries: Sequence[Any],
) -> tuple[tuple[Mapping[str, Any], ...], tuple[Tie, ...]]:
    """The definitions of a ``joints`` array, and its ties ``{"name", "tied_to", "ratio"}``. Raises ``JointError``."""
    definitions, ties = [], []
    for i, entry in enumerate(entries):
        if not (isinstance(entry, Mapping) and "tied_to" in entry):
            definitions.append(entry)
            continue
        where = f"joints[{i}]"
        unknown = sorted(set(entry) - _TIE_KEYS)
        if unknown:
            known = ", ".join(sorted(_TIE_KEYS))
            raise refused(f"{where}.{unknown[0]}", f"a tie has only {known}; the joint itself is another entry")
        ratio = number(entry, "ratio", where, default=1.0)
        if not is_ratio(ratio):
            raise refused(f"{where}.ratio", f"its size must be from {1 / LARGEST_RATIO:g} to {LARGEST_RATIO:g}")
        ties.append(Tie(str(entry.get("name")), str(entry["tied_to"]), ratio, where))
    return tuple(definitions), tuple(ties)


def is_ratio(ratio: float) -> bool:
    """Whether a joint can be tied to another by this factor."""
    return 1 / LARGEST_RATIO <= abs(ratio) <= LARGEST_RATIO


def tie_joints(joints: Sequence[Joint], ties: Sequence[Tie]) -> tuple[Joint, ...]:
    """Fold every tied joint into its leader, which then has the stages of both and the range that both allow.

    Raises ``JointError`` for a joint that is not there, a chain, unequal kinds, or ranges that do not meet.
    """
    found = {joint.name: joint for joint in joints}
    followers = {tie.name for tie in ties}
    for tie in ties:
        if tie.leader not in found or tie.name not in found:
            known = ", ".join(joint.name for joint in joints) or "none"
            missing = tie.name if tie.leader in found else tie.leader
            field = "name" if tie.leader in found else "tied_to"
            raise refused(
                f"{tie.where}.{field}", f"{missing!r} is no joint of the model (or tied already); it has {known}"
            )
        if tie.leader in followers:
            raise refused(f"{tie.where}.tied_to", f"{tie.leader!r} is itself tied; tie both to one joint")
        found[tie.leader] = _folded(found[tie.leader], found.pop(tie.name), tie)
    return tuple(found.values())


def _folded(leader: Joint, follower: Joint, tie: Tie) -> Joint:
    if leader.kind != follower.kind:
        raise refused(f"{tie.where}.tied_to", f"{tie.name!r} is {follower.kind}, {tie.leader!r} {leader.kind}")
    low, high = leader.minimum, leader.maximum
    if follower.period is None:  # else it may turn as often as it likes
        ends = sorted((follower.minimum / tie.ratio, follower.maximum / tie.ratio))
        low, high = max(low, ends[0]), min(high, ends[1])
    if low > high:
        raise refused(f"{tie.where}.tied_to", f"no value is in the ranges of both {tie.name!r} and {tie.leader!r}")
    initial = min(max(leader.initial, low), high)
    stages = (*leader.stages, *(_turned(stage, tie.ratio) for stage in follower.stages))
    return make_joint(leader.name, leader.kind, range_of(low, high, initial, tie.where), stages)


def _turned(stage: Stage, ratio: float) -> Stage:
    """The stage that does with a value what ``stage`` does with ``ratio`` times it."""
    x, y, z = stage.axis
    way = 1.0 if ratio > 0 else -1.0
    return replace(stage, axis=(way * x, way * y, way * z), ratio=abs(ratio) * stage.ratio)
