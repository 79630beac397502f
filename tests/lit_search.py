"""Frames of the small body that a search looks at, with and without its joint."""

import functools
from dataclasses import replace

import numpy as np
from lit_body import QUALITY, SUN, lit_body, shares
from scipy.spatial.transform import Rotation

from service.imaging.patch import Light, cut
from service.imaging.pieces import find_light
from service.inference.filters.grounds import FOLLOWED
from service.inference.model.candidates import Candidates
from service.inference.model.drawing import View
from service.inference.model.nuisance import Nuisance
from service.inference.model.rivals import Followed
from service.inference.model.search import Found, Track, make_bank
from service.inference.model.spread import PointSpread, spread
from service.inference.model.stages import ROUGH, Body, Sight, stage_hill
from service.inference.model.templates import Bank
from service.inference.numerics.hill import Hill
from service.inference.numerics.priors import PosePrior
from service.inference.pose import angle_between
from service.inference.state import Poses

SIGMA, SIZE = 4.0, 144
TOLD = PosePrior(towards_sun=SUN)


@functools.cache
def body(jointed: bool) -> Body:
    drawing = lit_body()
    if not jointed:
        drawing = replace(drawing, articulation=replace(drawing.articulation, joints=()))
    return Body(drawing, drawing, drawing)


@functools.cache
def bank(jointed: bool) -> Bank:
    return make_bank(body(jointed), TOLD)


def truth(seed: int, jointed: bool, rim_px: float = 26.0) -> Poses:
    quaternion = Rotation.random(random_state=seed).as_quat()[None]
    joints = np.random.default_rng(seed).uniform(-180, 180, (1, 1 if jointed else 0))
    return Poses(quaternion, np.array([[70.0, 75.0]]), np.log([rim_px / lit_body().radius]), joints)


def sight_of(at: Poses, size: int = SIZE, sun: np.ndarray = SUN) -> Sight:
    """The light of a frame that the model has made."""
    drawing = body(bool(at.joints.size)).fine
    drawn = drawing.combined(at, sun, shares(drawing, 700.0), View((0.0, 0.0), 1.0, size), QUALITY)
    image = spread(drawn, PointSpread(1.3), 0.0)[0] + np.random.default_rng(0).normal(0, SIGMA, (size, size))
    light = Light(image.astype(np.float32), SIGMA, 1e-3, 1.0, np.zeros(image.shape, bool))
    box = find_light(light)
    return Sight(lambda *square: cut(light, *square), box.centre, box.side, 1.1)


def dark_sight() -> Sight:
    """A frame of the empty sky."""
    light = Light(np.zeros((SIZE, SIZE), np.float32), SIGMA, 1e-3, 1.0, np.zeros((SIZE, SIZE), bool))
    return Sight(lambda *square: cut(light, *square), (72.0, 72.0), 40.0, 1.1)


def off_deg(found: Poses, at: Poses) -> np.ndarray:
    return np.rad2deg(angle_between(found.quaternion, at.quaternion[0]))


def half_turns(found: Poses, at: Poses) -> np.ndarray:
    """(N,) deg of the panel, which looks the same from either side."""
    return np.abs((found.joints - at.joints + 90) % 180 - 90)[:, 0]


def rough_hill(sight: Sight, told: PosePrior = TOLD) -> Hill:
    return stage_hill(body(True).rough, sight, ROUGH, Nuisance(1.3), told, speckle=False)


def is_ordered(found: Found) -> bool:
    values = [one.log_posterior for one in found.basins]
    return values == sorted(values, reverse=True)


def track_at(poses: Poses) -> Track:
    return Track(Candidates(poses, np.tile(SUN, (len(poses), 1)), np.zeros(len(poses))))


def followed(sight: Sight, modes: Poses) -> Followed:
    """As a track that has learnt the frame's point spread follows these modes, the likeliest first."""
    nuisance = Nuisance(1.3, discrepancy=0.005)
    hill = stage_hill(body(bool(modes.joints.size)).fine, sight, FOLLOWED, nuisance, TOLD, speckle=True)
    return Followed(track_at(modes).modes, sight, hill, nuisance)
