"""The filter of bodies before clutter: predict, propose, update, weigh, prune (docs/model.md, section 7).

Its state is the light filter's (``state.Mixture``), with what is known of colours and the last picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from service.inference.clutter.first import SAME_JOINT, Box, Coloured, Square, search, start
from service.inference.clutter.flow import Lift, Moved, Picture, follow, moved
from service.inference.clutter.judging import judged, status_of, told
from service.inference.clutter.settling import Expected, Settled, settle
from service.inference.domain import Domain
from service.inference.estimate import short_way, tangent
from service.inference.filters.answer import drawn, estimate_of
from service.inference.filters.status import one_answer
from service.inference.held import Held, believed
from service.inference.mesh_error import stated
from service.inference.model import existence, prior
from service.inference.model.drawing import Drawing, Lens
from service.inference.model.dynamics import corrected, new_born, predicted
from service.inference.motion import carry_on, motion_noise
from service.inference.numerics.priors import PosePrior
from service.inference.params import SessionConfig
from service.inference.pose import concatenate
from service.inference.state import Array, Clutter, Estimate, FilterState, Mixture, Poses
from service.inference.symmetry import Symmetry

_SIDE, _ROUNDS, _DRAWS = 96, 3, 48  # numerical: of a track: patch px, and how it climbs
_SIGHT = 2.6  # numerical: a side of what is looked at, in radii of the body
_MOST_MODES, _LEAST = 4, 1e-3  # numerical: that are kept; probability below which one is dropped
_LOOSE = (0.2, 0.1, 0.1, 0.2)  # numerical: as far as a climb without texture reaches, at the least


class Cluttered(Coloured, Protocol):
    """A frame before clutter: see ``service.workers.cluttered_frame``."""

    def picture(self, square: Square) -> tuple[Picture, Array]:
        """Grey levels of a square of the frame, and its first corner."""
        ...

    def remembered(self, picture: Picture, corner: Array) -> Clutter:
        """What the next frame is told."""
        ...


@dataclass(frozen=True)
class Surroundings:
    """All that a frame's step is given beside the state."""

    frame: Cluttered
    drawing: Drawing
    box: Box  # in which the body was told to be
    lift: Lift
    told: PosePrior
    config: SessionConfig
    domain: Domain
    twins: Sequence[Symmetry]
    lens: Lens | None
    n_paint: int  # planes of the light's filter, whose record of paint is kept empty
    index: int
    time_s: float
    held: Held | None = None  # the attitude mode that was told


def step(rng: np.random.Generator, state: FilterState | None, given: Surroundings) -> tuple[FilterState, Estimate]:
    """The posterior after a frame."""
    before = None if state is None else state.mixture
    dt_s = 0.0 if state is None else max(given.time_s - state.time_s, 0.0)
    if state is None or before is None or state.clutter is None:
        modes, frame = _born(rng, given)
    else:
        modes, frame = _followed(rng, before, dt_s, state.clutter, given)
    return _concluded(rng, modes, frame, before, dt_s, given)


@dataclass(frozen=True)
class _Modes:
    """K modes after a frame, not yet pruned."""

    settled: Settled
    rates: Array
    covariance: Array  # (K, 2d, 2d)
    log_weights: Array


def _born(rng: np.random.Generator, given: Surroundings) -> tuple[_Modes, Cluttered]:
    """Modes from nothing."""
    where = given.frame, given.box, given.drawing, given.told, given.lens
    found, frame = search(rng, *where, same=partial(_alike, given=given))
    noise = motion_noise(given.config.motion, given.domain)
    covariance = np.stack([new_born(one, noise) for one in found.covariance])
    weights = prior.EVIDENCE_TRUST * found.nats
    return _Modes(found, np.zeros((len(found.poses), covariance.shape[1] // 2)), covariance, weights), frame


def _alike(one: Poses, others: Poses, given: Surroundings) -> NDArray[np.bool_]:
    """(N,) whether they are one answer: turned alike, or as a body of this shape cannot be told from."""
    turned, spans = one_answer(one, others, given.twins, given.domain), given.domain.articulation.spans
    apart = np.abs(short_way(others.joints - one.joints, given.domain.wrapping))
    return np.asarray(turned & (apart <= SAME_JOINT * spans).all(axis=1))


def _followed(
    rng: np.random.Generator, before: Mixture, dt_s: float, clutter: Clutter, given: Surroundings
) -> tuple[_Modes, Cluttered]:
    """Each mode goes where its texture went, then climbs on the outline."""
    noise, wrapping = motion_noise(given.config.motion, given.domain), given.domain.wrapping
    ahead = np.stack([predicted(one, noise, dt_s) for one in before.covariance])
    onward = carry_on(before.poses, before.rates, dt_s)
    poses, covariance, texture = _by_texture(before, onward, ahead, clutter, given)
    lead = int(np.argmax(before.log_weights))
    frame, square = given.frame, _square(given.drawing, poses[lead : lead + 1])
    outlook = frame.outlook(given.drawing, square, _SIDE)
    expected = Expected(poses, np.asarray(np.linalg.inv(covariance)), wrapping)
    settled = settle(rng, outlook, poses, covariance, rounds=_ROUNDS, draws=_DRAWS, expected=expected)
    narrower = 0.5 * (np.linalg.slogdet(settled.covariance)[1] - np.linalg.slogdet(covariance)[1])
    log_weights = prior.EVIDENCE_KEPT * before.log_weights
    log_weights = log_weights + prior.EVIDENCE_TRUST * (settled.nats + texture + narrower)
    shifts = tangent(onward, settled.poses, wrapping)
    moving = [corrected(*one) for one in zip(before.rates, ahead, shifts, settled.covariance, strict=True)]
    rates, after = (np.stack(each) for each in zip(*moving, strict=True))
    return _Modes(settled, rates, after, log_weights), frame


def _by_texture(
    before: Mixture, poses: Poses, ahead: Array, clutter: Clutter, given: Surroundings
) -> tuple[Poses, Array, Array]:
    """Poses (K), covariance (K, d, d) and log likelihood (K,) of what the texture tells of each mode's movement.

    Where it tells nothing a mode is where its rates have brought it: ``poses``.
    """
    d = before.rates.shape[1]
    loose = start(given.drawing, poses, _LOOSE)
    covariance = ahead[:, :d, :d] + loose
    texture = np.zeros(len(poses))
    size = float(clutter.picture.shape[0])
    square = (float(clutter.corner[0] + 0.5 * size), float(clutter.corner[1] + 0.5 * size)), size
    after, _ = given.frame.picture(square)
    lead = int(np.argmax(before.log_weights))
    inside = _inside(given, before.poses[lead : lead + 1], square, clutter.picture.shape)
    points = follow(clutter.picture, after, inside, clutter.corner)
    if points is None:
        return poses, covariance, texture
    found: list[Moved | None] = []
    for k in range(len(poses)):
        one = before.poses[k : k + 1]
        on_body = given.lift(one, points.before)
        found.append(moved(given.domain.articulation, one, given.lens, on_body, points))
    least = min((one.nats for one in found if one is not None), default=0.0)
    for k, flow in enumerate(found):
        texture[k] = least if flow is None else flow.nats
        if flow is not None:
            covariance[k] = before.covariance[k, :d, :d] / prior.MEMORY_KEPT + flow.covariance
    here = [poses[k : k + 1] if flow is None else flow.pose for k, flow in enumerate(found)]
    return concatenate(*here), covariance, texture


def _inside(given: Surroundings, pose: Poses, square: Square, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """(H, W) what of a square of the frame the body covers."""
    covered = given.frame.outlook(given.drawing, square, _SIDE).covered(pose)[0]
    return np.asarray(cv2.resize(covered, shape[::-1], interpolation=cv2.INTER_LINEAR) > 0.5)


def _square(drawing: Drawing, pose: Poses) -> Square:
    """What is looked at about a pose (1)."""
    x, y = pose.position[0]
    return (float(x), float(y)), _SIGHT * drawing.radius * float(np.exp(pose.log_scale[0]))


def _concluded(
    rng: np.random.Generator, modes: _Modes, frame: Cluttered, before: Mixture | None, dt_s: float, given: Surroundings
) -> tuple[FilterState, Estimate]:
    """Prune, judge and tell."""
    kept, log_weights = _pruned(modes, given)
    poses = modes.settled.poses[kept]
    square = _square(given.drawing, poses[:1])
    outlook = frame.outlook(given.drawing, square, _SIDE)
    here, fit = judged(outlook, poses[:1], existence.expected(None if before is None else before.existence, dt_s))
    known = 0.0 if before is None else prior.COLOURS_KEPT
    if here[existence.FITS] >= 0.5:  # what else lies there has other colours
        frame = frame.learnt(outlook.view, outlook.covered(poses[:1])[0], known)
    k = len(kept)
    mixture = Mixture(
        poses=poses,
        rates=modes.rates[kept],
        covariance=modes.covariance[kept],
        suns=np.tile([0.0, 0.0, -1.0], (k, 1)),
        sun_sigmas=np.full(k, np.pi),
        paint=np.zeros((k, 2, given.n_paint)),
        log_weights=log_weights,
        existence=here,
        point_spread=np.array([prior.CORE_PX, 0.0]),
        discrepancy=prior.DISCREPANCY,
        log_chi2=existence.usual_chi2(),
        log_light=0.0,
        span_px=square[1],
        ever_tracked=False,
        searches=0,
        misses=0,
        since_search=0,
    )
    probabilities = told(here)
    status = status_of(probabilities)
    weighed = stated(believed(mixture, given.held), given.domain)
    particles, rates = drawn(rng, weighed, given.config.filter.particles, given.domain)
    nats = float(modes.settled.nats[kept[0]])
    estimate = estimate_of(weighed, particles, status, given.domain, probabilities, (nats, nats), fit)
    even = np.full(len(particles), -np.log(len(particles)))
    remembered = frame.remembered(*frame.picture(square))
    state = FilterState(particles, even, rates, given.index, given.time_s, status, {}, mixture, remembered)
    return state, estimate


def _pruned(modes: _Modes, given: Surroundings) -> tuple[NDArray[np.intp], Array]:
    """The heaviest, heaviest first, and logs of their weights; those that are one answer are one."""
    log_weights, kept = modes.log_weights - np.logaddexp.reduce(modes.log_weights), list[int]()
    for k in np.argsort(-log_weights):
        same = np.zeros(len(kept), bool)
        if kept:
            same = _alike(modes.settled.poses[k : k + 1], modes.settled.poses[np.array(kept)], given)
        if same.any():
            first = kept[int(np.argmax(same))]
            log_weights[first] = np.logaddexp(log_weights[first], log_weights[k])
        elif len(kept) < _MOST_MODES and (not kept or log_weights[k] > np.log(_LEAST)):
            kept.append(int(k))
    which = np.array(kept)
    which = which[np.argsort(-log_weights[which])]
    return which, log_weights[which] - np.logaddexp.reduce(log_weights[which])
