"""The motion of a pass: beliefs in, a posterior over motions out (docs/motion.md). Needs no images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gpu.mesh import Mesh
from service.errors import ConflictError
from service.inference.articulation import hold
from service.inference.belief import Belief
from service.inference.domain import Domain
from service.inference.motion import motion_noise
from service.inference.pose import conjugate, from_matrices
from service.inference.spin.attitude_modes import attitude_modes
from service.inference.spin.basins import PassMotion
from service.inference.spin.fit import LEAST_FRAMES, evenly, fit_pass
from service.inference.spin.frames import PassFrames, pass_frames, seen_from, with_equivalents
from service.inference.spin.own import Own, own_likelihoods
from service.inference.spin.rigid_body import shape_of
from service.inference.state import Array
from service.inference.symmetry import Symmetry
from service.models.symmetry_group import held_symmetries
from service.workers.base import MotionJob
from service.workers.codec import decode
from service.workers.full_frame import camera_window

_ANY_RADIUS = 1.0  # the body's size shifts the bounds of the scale, which nothing here asks for


def motion_of(job: MotionJob, mesh: Mesh | None) -> PassMotion:
    """The motions that the frames may be of; ``mesh``: what the masses are guessed from.

    Raises ``ConflictError`` for too few frames, ``CheckpointError`` for a broken belief.
    """
    articulation = hold(job.articulation, job.config.joints.free, job.config.joints.fixed)
    size = camera_window(job.config.camera, job.width, job.height).size
    domain = Domain(*size, _ANY_RADIUS, articulation, job.config.prior)
    noise = motion_noise(job.config.motion, domain)
    bootstrap = job.config.filter.method == "bootstrap"
    beliefs = [None if packed is None else decode(Belief, packed) for packed in job.beliefs]
    own = own_likelihoods(beliefs, noise, domain, bootstrap=bootstrap)
    symmetries = held_symmetries(job.twins, job.articulation, articulation)
    # What lights the surfaces tells mirror twins apart; outlines do not.
    alike = [s for s in symmetries if s.kind == "rotation" or (bootstrap and s.kind == "mirror")]
    frames, numbers = _frames(job, beliefs, own, alike)
    turns = [conjugate(from_matrices(np.asarray(s.matrix))) for s in alike if s.kind == "rotation"]
    rate_sigma = job.config.motion.rate_spread * float(np.sqrt(noise.jitter[0]))
    found = fit_pass(frames, rate_sigma, None if mesh is None else shape_of(second_moments(mesh)), turns)
    if not found.basins:
        detail = f"no motion of a free or steadily turning body explains {LEAST_FRAMES} of the {len(frames)} frames"
        raise ConflictError(detail, frames=len(frames))
    if job.references is None or job.cameras is None:
        return found
    references = {name: from_matrices(one[numbers]) for name, one in job.references.items()}
    return replace(found, attitude=attitude_modes(frames, references, found))


def _frames(
    job: MotionJob, beliefs: Sequence[Belief | None], own: Sequence[Own | None], alike: Sequence[Symmetry]
) -> tuple[PassFrames, NDArray[np.intp]]:
    """What the frames that count say by themselves, in order of time, and their numbers."""
    told = [
        (belief.time_s, k, one)
        for k, (belief, one, counts) in enumerate(zip(beliefs, own, job.counts, strict=True))
        if belief is not None and one is not None and counts
    ]
    if len({time_s for time_s, _, _ in told}) < LEAST_FRAMES:
        detail = f"a motion needs {LEAST_FRAMES} frames in which the object is seen, each at its own time"
        raise ConflictError(detail, frames=len(told), needed=LEAST_FRAMES)
    told.sort(key=lambda one: one[:2])
    told = [told[k] for k in evenly(len(told))]
    numbers = np.array([k for _, k, _ in told])
    parts = ([getattr(one, name) for _, _, one in told] for name in ("quaternion", "covariance", "weight"))
    frames = with_equivalents(pass_frames(np.array([time_s for time_s, _, _ in told]), *parts), alike)
    if job.cameras is not None:
        frames = seen_from(frames, np.array([job.cameras[k] for k in numbers]))
    return frames, numbers


def second_moments(mesh: Mesh) -> Array:
    """(3, 3) of a thin shell, joints at rest: spacecraft are hollow, and a mesh need not be closed."""
    vertices = np.vstack([part.vertices for part in mesh.parts])
    corners = vertices[mesh.faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    share = area / area.sum()
    centre = share @ corners.mean(axis=1)
    corners = corners - centre
    # Of a triangle: (sum of corners' squares + 9 times the mean's) / 12.
    middle = corners.mean(axis=1)
    return np.asarray(
        (np.einsum("f,fci,fcj->ij", share, corners, corners) + 9 * np.einsum("f,fi,fj->ij", share, middle, middle)) / 12
    )
