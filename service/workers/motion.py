"""The motion of a pass: beliefs in, a posterior over motions out (docs/motion.md). Needs no images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

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
from service.inference.spin.frames import PassFrames, merged, pass_frames, seen_from, with_equivalents
from service.inference.spin.own import own_likelihoods
from service.inference.spin.rigid_body import shape_of
from service.inference.state import Array
from service.models.symmetry_group import held_symmetries
from service.workers.base import MotionJob
from service.workers.codec import decode
from service.workers.full_frame import camera_window
from service.workers.joint_laws import Jointed, laws_of_joints, suns_in_camera

_ANY_RADIUS = 1.0  # the body's size shifts the bounds of the scale, which nothing here asks for


def motion_of(job: MotionJob, mesh: Mesh | None) -> PassMotion:
    """The motions that the frames may be of; ``mesh``: what the masses are guessed from.

    Raises ``ConflictError`` for too few frames, ``CheckpointError`` for a broken belief.
    """
    stations = [_Station(one) for one in (job, *job.others)]
    seen = [one for one in stations if one.numbers]
    if len({time_s for one in seen for time_s in one.time_s}) < LEAST_FRAMES:
        detail = f"a motion needs {LEAST_FRAMES} frames in which the object is seen, each at its own time"
        raise ConflictError(detail, frames=sum(len(one.numbers) for one in seen), needed=LEAST_FRAMES)
    frames, order = merged([one.frames() for one in seen])
    rate_sigma = max(one.rate_sigma for one in seen)
    found = fit_pass(frames, rate_sigma, None if mesh is None else shape_of(second_moments(mesh)), seen[0].turns)
    if not found.basins:
        detail = f"no motion of a free or steadily turning body explains {LEAST_FRAMES} of the {len(frames)} frames"
        raise ConflictError(detail, frames=len(frames))
    references = [one.job.references for one in seen if one.job.references is not None]
    if len(references) < len(seen):
        return found
    held = {
        name: from_matrices(
            np.concatenate([mine[name][one.numbers] for mine, one in zip(references, seen, strict=True)])
        )
        for name in references[0]
    }
    attitude = attitude_modes(frames, {name: q[order] for name, q in held.items()}, found)
    joints = () if mesh is None else laws_of_joints([one.jointed() for one in seen], mesh, found)
    return replace(found, attitude=attitude, joints=joints)


class _Station:
    """One telescope's frames that count, in order of time."""

    def __init__(self, job: MotionJob) -> None:
        self.job = job
        articulation = self._articulation = hold(job.articulation, job.config.joints.free, job.config.joints.fixed)
        size = camera_window(job.config.camera, job.width, job.height).size
        domain = Domain(*size, _ANY_RADIUS, articulation, job.config.prior)
        noise = motion_noise(job.config.motion, domain)
        bootstrap = job.config.filter.method == "bootstrap"
        beliefs = [None if packed is None else decode(Belief, packed) for packed in job.beliefs]
        own = own_likelihoods(beliefs, noise, domain, bootstrap=bootstrap)
        told = [
            (belief.time_s + job.offset_s, k, one)
            for k, (belief, one, counts) in enumerate(zip(beliefs, own, job.counts, strict=True))
            if belief is not None and one is not None and counts
        ]
        told.sort(key=lambda one: one[:2])
        told = [told[k] for k in evenly(len(told), 1 + len(job.others))] if told else []
        self.time_s, self.numbers = [time_s for time_s, _, _ in told], [k for _, k, _ in told]
        self._own = [one for _, _, one in told]
        self._beliefs = [belief for k in self.numbers if (belief := beliefs[k]) is not None]
        self.rate_sigma = job.config.motion.rate_spread * float(np.sqrt(noise.jitter[0]))
        symmetries = held_symmetries(job.twins, job.articulation, articulation)
        # What lights the surfaces tells mirror twins apart; outlines do not.
        self._alike = [s for s in symmetries if s.kind == "rotation" or (bootstrap and s.kind == "mirror")]
        self.turns = [conjugate(from_matrices(np.asarray(s.matrix))) for s in self._alike if s.kind == "rotation"]

    def frames(self) -> PassFrames:
        """What each says by itself: body -> GCRF where the cameras are known, else body -> camera."""
        parts = ([getattr(one, name) for one in self._own] for name in ("quaternion", "covariance", "weight"))
        frames = with_equivalents(pass_frames(np.array(self.time_s), *parts), self._alike)
        if self.job.cameras is None:
            return frames
        return seen_from(frames, np.array([self.job.cameras[k] for k in self.numbers]))

    def jointed(self) -> Jointed:
        """What they say of the joints; where cameras and references are known."""
        assert self.job.references is not None and self.job.cameras is not None
        cameras = np.array([self.job.cameras[k] for k in self.numbers])
        suns = suns_in_camera(self.job.references["sun_pointing"][self.numbers], cameras)
        return Jointed(self._articulation, self.job.config.joints, self._beliefs, suns)


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
