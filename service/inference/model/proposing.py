"""The templates most like a frame: where a search begins (docs/model.md, section 4)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from service.inference.model import bank as banks
from service.inference.model.candidates import SHARED_DEG, Candidates, distinct, joined
from service.inference.model.stages import WHOLE, Part, PatchLike
from service.inference.model.templates import Bank
from service.inference.numerics.priors import PosePrior
from service.inference.pose import exp_so3, multiply, rotation_matrices
from service.inference.state import Poses

_OF_THEM = 0.7  # numerical: of the templates, in a later search
_PER_KIND = 80  # numerical: templates of each kind that are looked at with the likelihood
# numerical: templates and ways to turn the frame together where no Sun is told: rotation and Sun 20 degrees apart
_TURNED = 72_000


def turns(n_templates: int, told: PosePrior) -> int:
    """Ways to turn the frame: one where the Sun is told."""
    return 1 if told.towards_sun is not None else max(round(_TURNED / n_templates), 1)


def propose(
    bank: Bank, patch: PatchLike, told: PosePrior, part: Part = WHOLE, rng: np.random.Generator | None = None
) -> Candidates:
    """The templates most like the frame: the best of each kind.

    Where no Sun is told, a template is as good for a body that is turned about the line of sight together with its
    Sun: the frame, turned a few ways, is held against all of them.
    ``part``: has a share of the ways, or of the templates where there is one way.
    ``rng``: where there is one way, some of the templates are left out, so that those have their turn that they crowd
    out.
    """
    count, kept = turns(len(bank.poses), told), part.share(_PER_KIND)
    ways = 2 * np.pi / count * np.arange(count)
    if count == 1:
        bank = bank[part.own]
        if rng is not None:
            bank = bank[rng.random(len(bank.poses)) < _OF_THEM]
    else:
        ways = ways[part.own]
    met = [_met(bank, patch, told, way, kept, roughly=count > 1) for way in ways]
    some = joined([_best(joined(of_kind), kept) for of_kind in zip(*met, strict=True)])
    poses = some.poses
    position = poses.position * patch.binning + np.asarray(patch.origin)
    placed = Poses(poses.quaternion, position, poses.log_scale + np.log(patch.binning), poses.joints)
    return Candidates(placed, some.suns, np.full(len(placed), -np.inf))


def _met(bank: Bank, patch: PatchLike, told: PosePrior, turn: float, kept: int, roughly: bool) -> list[Candidates]:
    """Of each kind the likest templates, in patch px, if the frame is turned by so much (rad) from x to y; where light
    touches what is not seen, then those of bodies that go on there.

    ``roughly``: most templates are compared by their principal pictures, which are worth finding for many turns.
    """
    image, out = _turned(patch.image, turn), []
    ways = [banks.looks(image, patch.sigma)]
    if patch.unseen.any():
        unseen = _turned(patch.unseen.astype(np.float32), turn) > 0
        ways.append(banks.looks_beyond(image, patch.sigma, unseen))
    log_scale = None if told.log_scale is None else told.log_scale - np.log(patch.binning)
    for seen in ways:
        scores, poses = banks.match(bank, seen, log_scale, told.log_scale_sigma, 3 * kept if roughly else None)
        for score, here in zip(scores, poses, strict=True):
            order = np.argsort(-score)[: 3 * kept]
            out.append(_turned_back(Candidates(here[order], bank.suns[order], score[order]), len(patch.image), turn))
    return out


def _best(some: Candidates, kept: int) -> Candidates:
    order = np.argsort(-some.found)[: 3 * kept]
    order = order[some.found[order] > 0]
    return some[order[distinct(some.poses[order], np.deg2rad(SHARED_DEG))][:kept]]


def _turned(image: NDArray[np.float32], turn: float) -> NDArray[np.float32]:
    """About its middle."""
    if not turn:
        return image
    middle = 0.5 * (len(image) - 1)  # of pixels' centres
    matrix = cv2.getRotationMatrix2D((middle, middle), -np.rad2deg(turn), 1.0)  # which turns from y to x
    return np.asarray(cv2.warpAffine(image, matrix, image.shape[::-1], flags=cv2.INTER_LINEAR), np.float32)


def _turned_back(some: Candidates, side: int, turn: float) -> Candidates:
    """What poses in a turned picture mean in the picture itself."""
    poses, about = some.poses, exp_so3(np.array([[0.0, 0.0, -turn]]))
    back = rotation_matrices(about)[0]
    position = 0.5 * side + (poses.position - 0.5 * side) @ back[:2, :2].T
    moved = Poses(multiply(about, poses.quaternion), position, poses.log_scale, poses.joints)
    return Candidates(moved, some.suns @ back.T, some.found)
