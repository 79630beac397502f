"""The joints of a pass: what its frames say of each hinge, and of the Sun (docs/motion.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gpu.mesh import Mesh
from service.inference.articulation import Articulation
from service.inference.belief import Belief
from service.inference.model import prior
from service.inference.model.sun_tracking import SunTracking
from service.inference.numerics.student import scale_of
from service.inference.params import JointParams
from service.inference.pose import rotation_matrices
from service.inference.spin.basins import JointLaw, PassMotion
from service.inference.spin.joint_laws import Seen, SeenJoint, joint_law
from service.inference.state import Array
from service.workers.panels import sun_tracking

_TURN_DEG = 360.0
_LEAST_SIGMA_DEG = 1e-3  # numerical: so that it can be divided by


@dataclass(frozen=True)
class Jointed:
    """What one telescope's frames that count say of a body's joints."""

    articulation: Articulation
    told: JointParams
    beliefs: Sequence[Belief]
    suns: Array  # (n, 3) towards the Sun, camera axes


def laws_of_joints(every: Sequence[Jointed], mesh: Mesh, found: PassMotion) -> tuple[JointLaw, ...]:
    """Of each hinge that is estimated, but for those that the session was told to follow the Sun: they were held so."""
    seen: dict[str, list[SeenJoint]] = {}
    for joint in (joint for one in every for joint in _seen(one, mesh)):
        seen.setdefault(joint.name, []).append(joint)
    lead = found.basins[0]
    counted = (1 - prior.MEMORY_KEPT) * lead.independent / (lead.explained * found.n_frames)  # frames that err alike
    return tuple(joint_law(_merged(alike), min(counted, 1.0)) for _, alike in sorted(seen.items()))


def _seen(one: Jointed, mesh: Mesh) -> list[SeenJoint]:
    hinges = [joint for joint in one.articulation.joints if joint.kind == "revolute"]
    names = tuple(joint.name for joint in hinges if joint.name not in one.told.sun_tracking)
    tracking = sun_tracking(mesh, one.articulation, replace(one.told, sun_tracking=names))
    if tracking is None:
        return []
    heaviest = [int(np.argmax(belief.log_weights)) for belief in one.beliefs]
    value, sigma, lacks, lacks_sigma = [], [], [], []
    for belief, k, sun in zip(one.beliefs, heaviest, one.suns, strict=True):
        d, pose = belief.n_tangent, belief.poses[k : k + 1]
        scale = scale_of(belief.covariance[k][:d, :d], prior.POSE_DEGREES_OF_FREEDOM)
        off, slopes = tracking.slopes(pose, sun)
        slopes = slopes * tracking.sigma_deg
        value.append(pose.joints[0, list(tracking.columns)])
        sigma.append(np.sqrt(np.diag(scale)[[6 + column for column in tracking.columns]]))
        lacks.append(off * tracking.sigma_deg)
        lacks_sigma.append(np.sqrt(np.einsum("ki,ij,kj->k", slopes, scale, slopes)))
    columns = np.array(value), np.array(sigma), np.array(lacks), np.array(lacks_sigma)
    return [_joint(tracking, k, *(part[:, k] for part in columns)) for k in range(len(tracking.columns))]


def _joint(tracking: SunTracking, k: int, value: Array, sigma: Array, lacks: Array, lacks_sigma: Array) -> SeenJoint:
    joint, side = tracking.articulation.joints[tracking.columns[k]], tracking.side_deg(k)
    span = joint.maximum - joint.minimum
    turns = _TURN_DEG if span >= _TURN_DEG else np.inf
    either = side if span >= side else np.inf  # as far as it turns, either side of a panel may face the Sun
    least = np.full(len(value), _LEAST_SIGMA_DEG)
    return SeenJoint(
        joint.name,
        Seen(value, np.maximum(sigma, least), turns),
        Seen(lacks, np.maximum(lacks_sigma, least), either),
        min(span, _TURN_DEG),
        tracking.sigma_deg,
    )


def _merged(alike: Sequence[SeenJoint]) -> SeenJoint:
    """One joint as several telescopes saw it."""

    def both(parts: Sequence[Seen]) -> Seen:
        value, sigma = (np.concatenate([getattr(part, name) for part in parts]) for name in ("value", "sigma"))
        return Seen(value, sigma, parts[0].period)

    return replace(alike[0], value=both([one.value for one in alike]), lacks=both([one.lacks for one in alike]))


def suns_in_camera(frames: Array, cameras: Array) -> Array:
    """(n, 3) of ``sun_pointing`` frames (n, 3, 3) -> GCRF, whose z is towards the Sun, and cameras (n, 4) -> GCRF."""
    return np.asarray(np.einsum("nji,nj->ni", rotation_matrices(cameras), frames[:, :, 2]))
