"""From nothing but a box about the body: what of all turns, sizes and joints fits the outline (docs/model.md, 7)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from service.inference.clutter.outlook import Outlook
from service.inference.clutter.settling import Expected, Settled, settle
from service.inference.model.drawing import Drawing, Images, Lens, View
from service.inference.model.templates import drawn_joints, rotations
from service.inference.numerics.priors import PosePrior
from service.inference.pose import angle_between
from service.inference.state import Array, Poses

Square = tuple[tuple[float, float], float]  # its middle and side, frame px
Box = tuple[float, float, float, float]  # x, y, width, height; frame px
Same = Callable[[Poses, Poses], NDArray[np.bool_]]  # (1) and (N) poses: (N,) which are one answer with it
_TURNS = 4_500  # numerical: 12 degrees apart
_PLACED = 2  # numerical: times that each is brought into the box
_BOXES = (1.0, 0.8, 0.65)  # numerical: shares of the told box that are tried: it may be loose
_PAD = 0.05  # prior: of a told box's sides that lies about the body
_SHOWN = 0.3  # numerical: of a pixel that is covered, from which on it counts for an outline's extent
_SIGHT = 1.6  # numerical: of the box's longer side that is looked at
_APART_RAD = 0.2  # numerical: turns that are nearer are of one basin
SAME_JOINT = 0.06  # numerical: share of a joint's range: values that are nearer are one answer


@dataclass(frozen=True)
class _Stage:
    """Numerical, all of it: a search that stops early misses the truth, no more."""

    side: int  # patch px
    kept: int
    rounds: int
    draws: int
    spread: tuple[float, float, float, float]  # rad, share of the size, log scale, share of a joint's range


# numerical: all of them
_STAGES = (
    _Stage(48, 30, 6, 32, (0.15, 0.06, 0.12, 0.1)),
    _Stage(64, 16, 4, 64, (0.1, 0.03, 0.04, 0.06)),
    _Stage(64, 8, 4, 64, (0.08, 0.02, 0.03, 0.04)),
    _Stage(96, 6, 4, 96, (0.06, 0.02, 0.02, 0.03)),
)
_FIRST_SIDE, _BATCH = 32, 500  # numerical: patch px; pictures at once


class Coloured(Protocol):
    """A frame and what is known of its body's and its clutter's colours."""

    def outlook(self, drawing: Drawing, square: Square, side: int) -> Outlook:
        """log c on a patch."""
        ...

    def narrowed(self, box: Box) -> Self:
        """The same, colours learnt as if the body were told to lie in this box."""
        ...

    def learnt(self, view: View, inside: Images, kept: float = 0.0) -> Self:
        """The same, with more known of colours: ``inside`` (S, S) is the body's share of a patch px, ``kept`` the share
        of what was known.
        """
        ...


F = TypeVar("F", bound=Coloured)


def search(
    rng: np.random.Generator,
    frame: F,
    box: Box,
    drawing: Drawing,
    told: PosePrior,
    lens: Lens | None,
    same: Same,
) -> tuple[Settled, F]:
    """What fits the outline of the body in a box, best first, and the frame with what that tells of colours.

    Outline and colours are found in turns: each tells more of the other.
    """
    look = _Look(rng, drawing, told, lens, box)
    tries = [look.begun(frame, share) for share in _BOXES]
    found, frame = max(tries, key=look.sharpness)
    for stage in _STAGES[1:]:
        found = found[_apart(found, stage.kept, drawing.articulation.spans, same)]
        found, frame = look.climbed(found, frame, stage)
    return found[_apart(found, _STAGES[-1].kept, drawing.articulation.spans, same)], frame


@dataclass(frozen=True)
class _Look:
    """A search of one frame."""

    rng: np.random.Generator
    drawing: Drawing
    told: PosePrior
    lens: Lens | None
    box: Box

    @property
    def square(self) -> Square:
        """What is looked at."""
        x, y, width, height = self.box
        return (x + 0.5 * width, y + 0.5 * height), _SIGHT * max(width, height)

    def begun(self, frame: F, share: float) -> tuple[Settled, F]:
        """The first stage, as if the told box were smaller by ``share``."""
        x, y, width, height = self.box
        inner = x + 0.5 * (1 - share) * width, y + 0.5 * (1 - share) * height, share * width, share * height
        frame = frame.narrowed(inner)
        outlook = frame.outlook(self.drawing, self.square, _FIRST_SIDE)
        poses = _in_box(outlook, inner, self.told, self.lens)
        found = Settled(poses, np.empty((len(poses), 0, 0)), outlook.score(poses))
        found = found[_apart(found, _STAGES[0].kept, self.drawing.articulation.spans, None)]
        return self.climbed(found, frame, _STAGES[0])

    def sharpness(self, one: tuple[Settled, F]) -> float:
        """How much the best outline tells for its size: what it loses where it lies beside its rim."""
        found, frame = one
        covered = frame.outlook(self.drawing, self.square, _FIRST_SIDE).covered(found.poses[np.array([0])])
        return float(found.nats[0] / np.sqrt(max(float(covered.sum()), 1.0)))

    def climbed(self, found: Settled, frame: F, stage: _Stage) -> tuple[Settled, F]:
        """Poses at their best, best first, and the frame with what they tell of colours."""
        outlook = frame.outlook(self.drawing, self.square, stage.side)
        spread, size = start(self.drawing, found.poses, stage.spread), _told_size(self.drawing, found.poses, self.told)
        climb = {"rounds": stage.rounds, "draws": stage.draws}
        found = settle(self.rng, outlook, found.poses, spread, expected=size, **climb)
        found = found[np.argsort(-found.nats)]
        return found, frame.learnt(outlook.view, _share(outlook, found))


def start(drawing: Drawing, poses: Poses, spread: tuple[float, float, float, float]) -> Array:
    """(K, d, d) diagonal: turn (rad), place (share of the body's size), log scale, joints (share of their range)."""
    turn, place, scale, joint = spread
    size = 2 * drawing.radius * np.exp(poses.log_scale)
    spans = np.broadcast_to(joint * drawing.articulation.spans, poses.joints.shape)
    ones = np.ones((len(poses), 1))
    sigma = np.hstack([turn * ones, turn * ones, turn * ones, place * size[:, None], place * size[:, None]])
    sigma = np.hstack([sigma, scale * ones, spans])
    return np.asarray(sigma[:, :, None] ** 2 * np.eye(sigma.shape[1]))


def _told_size(drawing: Drawing, poses: Poses, told: PosePrior) -> Expected | None:
    """What is known of the scale beside the frame."""
    if told.log_scale is None:
        return None
    d = 6 + poses.joints.shape[1]
    precision = np.zeros((len(poses), d, d))
    precision[:, 5, 5] = told.log_scale_sigma**-2
    there = replace(poses, log_scale=np.full(len(poses), told.log_scale))
    return Expected(there, precision, drawing.articulation.wrapping)


def _in_box(outlook: Outlook, box: Box, told: PosePrior, lens: Lens | None) -> Poses:
    """Every turn of the body, as large as its box lets it be or as it is told to be."""
    x, y, width, height = box
    drawing, middle = outlook.drawing, np.array([x + 0.5 * width, y + 0.5 * height])
    size = np.log(max(width, height) / (2 * drawing.radius)) if told.log_scale is None else told.log_scale
    poses = Poses(
        rotations(_TURNS),
        np.tile(middle, (_TURNS, 1)),
        np.full(_TURNS, size),
        drawn_joints(drawing.articulation, _TURNS),
    )
    if lens is not None:
        poses = lens.aimed(poses)
    for _ in range(_PLACED):
        low, high = _extent(outlook, poses)
        larger = np.sqrt(width * height / np.prod(np.maximum(high - low, 1.0), axis=1)) / (1 + 2 * _PAD)
        larger = np.log(larger) if told.log_scale is None else np.zeros(_TURNS)
        poses = replace(
            poses, position=poses.position + middle - 0.5 * (low + high), log_scale=poses.log_scale + larger
        )
    return poses


def _extent(outlook: Outlook, poses: Poses) -> tuple[Array, Array]:
    """(N, 2) least and greatest x and y of silhouettes, frame px; of one that shows nothing: the patch's."""
    parts = [poses[slice(k, k + _BATCH)] for k in range(0, len(poses), _BATCH)]
    shown = np.concatenate([outlook.covered(one) > _SHOWN for one in parts])
    corner, binning = np.asarray(outlook.view.origin), outlook.view.binning
    lines = [np.asarray(shown.any(axis=axis)) for axis in (1, 2)]  # of x, of y
    first = np.stack([line.argmax(axis=1) for line in lines], axis=1)
    last = np.stack([line.shape[1] - line[:, ::-1].argmax(axis=1) for line in lines], axis=1)
    return corner + binning * first, corner + binning * last


def _apart(found: Settled, most: int, spans: Array, same: Same | None) -> NDArray[np.intp]:
    """The best of those that are not turned alike."""
    left, kept = np.argsort(-found.nats), list[int]()
    while len(left) and len(kept) < most:
        lead = left[:1]
        kept.append(int(lead[0]))
        others, one = found.poses[left], found.poses[lead]
        held = np.all(np.abs(others.joints - one.joints) <= SAME_JOINT * spans, axis=1)
        turned = np.asarray(angle_between(others.quaternion, one.quaternion))
        near = np.asarray(held & (turned < _APART_RAD))
        if same is not None:
            near |= same(one, others)
        near[0] = True
        left = left[~near]
    return np.array(kept)


def _share(outlook: Outlook, found: Settled) -> Images:
    """(S, S) body's share of a patch px, whichever of them is right."""
    weights = np.exp(found.nats - found.nats.max())
    some = weights > 1e-3
    return np.tensordot((weights[some] / weights[some].sum()).astype(np.float32), outlook.covered(found.poses[some]), 1)
