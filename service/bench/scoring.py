"""One frame's answer against the truth, modulo what no silhouette can tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.bench.cases import Case, TruthFrame
from service.bench.silhouette import Mask, fine_silhouette, overlap
from service.inference.articulation import Articulation, Joint, hold
from service.inference.model.prior import POSE_DEGREES_OF_FREEDOM
from service.inference.numerics.student import scale_of, share_within, squared_radius
from service.inference.pose import concatenate, local
from service.inference.revolution import Axis, angle_apart
from service.inference.state import Array, Estimate, Mode, PoseEstimate, Poses
from service.inference.symmetry import Symmetry, twin
from service.models.symmetry_group import held_symmetries, make_symmetry
from service.simulate.compare import joint_error

LEAST_WEIGHT = 0.1  # of a mode that counts as reported
TWIN_FOUND_DEG = 5.0  # a mode this near to a pose reports it
_TIED_DEG = 1e-6
_FULL_TURN_DEG = 360.0
_NAN = float("nan")


@dataclass(frozen=True)
class FrameScore:
    """What one frame came to. Figures of a frame that shows no object are NaN."""

    index: int
    time_s: float
    visible: bool
    status: str
    ms: float
    orientation_deg: float = _NAN  # of ``best``
    modes_deg: float = _NAN  # of the nearest reported mode
    ratio: float = _NAN  # that error over the mode's own RMS spread
    position_px: float = _NAN
    scale_percent: float = _NAN
    joint: float = _NAN
    iou: float = _NAN
    n_modes: int = 0
    twins_reported: bool | None = None  # None: the body has no mirror plane
    raw_deg: float = _NAN  # of ``best``, no symmetry excusing anything
    region: float = _NAN  # probability of the nearest mode's own region that just reaches the true rotation
    joints90: float = _NAN  # share of the joints that lie within the 90 % interval which that mode states


class Referee:
    """Knows a case's body: draws it, and knows which poses look alike."""

    def __init__(self, case: Case) -> None:
        self._case = case
        self.articulation: Articulation = hold(case.model.articulation, case.free, {})
        self._alike = ambiguity(case, self.articulation)
        self._axes = self.articulation.round_axes
        self._mirrored = np.array([False, *(symmetry.kind == "mirror" for symmetry in self._alike)])

    def draw(self, pose: Poses) -> Mask:
        """The fine silhouette of a batch of one."""
        return fine_silhouette(self._case.model.mesh, self.articulation, pose, self._case.size)

    def score(self, index: int, truth: TruthFrame, real: Mask | None, estimate: Estimate, ms: float) -> FrameScore:
        """Hold an answer against the truth; ``real`` is the true silhouette, None for a frame without the body."""
        if real is None:
            return FrameScore(index, truth.time_s, False, estimate.status, ms)
        alike, best = self._alike_to(truth), estimate.best
        angles = _angles_deg(best, alike, self._axes)
        joint, position = self._nearest(best, alike, angles)
        modes = [mode for mode in estimate.modes if mode.weight >= LEAST_WEIGHT]
        nearest_deg, width_deg, region, joints90 = self._nearest_mode(modes, estimate, alike)
        return FrameScore(
            index=index,
            time_s=truth.time_s,
            visible=True,
            status=estimate.status,
            ms=ms,
            orientation_deg=float(angles.min()),
            raw_deg=float(angles[0]),
            region=region,
            joints90=joints90,
            modes_deg=nearest_deg,
            ratio=nearest_deg / width_deg if width_deg else _NAN,
            position_px=position,
            scale_percent=100.0 * abs(best.scale / truth.scale - 1.0),
            joint=joint,
            iou=overlap(real, self.draw(_batch(best))),
            n_modes=max(1, len(modes)),
            twins_reported=self._twins_reported(estimate.modes, alike),
        )

    def error_deg(self, truth: TruthFrame, found: PoseEstimate) -> float:
        """Degrees between a rotation and the nearest that looks as the true one does."""
        return float(_angles_deg(found, self._alike_to(truth), self._axes).min())

    def _alike_to(self, truth: TruthFrame) -> Poses:
        """The true pose, and those that look as it does."""
        true = truth.poses(self.articulation)
        return concatenate(true, *(twin(true, symmetry) for symmetry in self._alike))

    def _nearest(self, found: PoseEstimate, alike: Poses, angles: Array) -> tuple[float, float]:
        """Joint and position error against those of the alike poses that are nearest in orientation."""
        tied = np.flatnonzero(angles <= angles.min() + _TIED_DEG)
        errors = [
            (max(self._joint_errors(found, v), default=0.0), float(np.linalg.norm(found.position - p)))
            for v, p in zip(alike.joints[tied], alike.position[tied], strict=True)
        ]
        return min(errors)

    def _nearest_mode(
        self, modes: Sequence[Mode], estimate: Estimate, alike: Poses
    ) -> tuple[float, float, float, float]:
        """Error of the nearest reported mode, its spread (the whole estimate's where it has none), its region, and the
        share of its joints that are where it says.
        """
        told = [(mode.pose, mode.spread) for mode in modes] or [(estimate.best, estimate.spread)]
        angles = np.array([_angles_deg(pose, alike, self._axes) for pose, _ in told])
        k, true = np.unravel_index(int(np.argmin(angles)), angles.shape)
        pose, spread = told[k]
        off = np.rad2deg(local(_batch(pose), alike[true : true + 1])[0, :3])
        width = spread.orientation_deg or estimate.spread.orientation_deg
        joints90 = self._joints_within(pose, spread.joints, alike.joints[true])
        return float(angles[k, true]), width, region_of(off, spread.covariance[:3, :3]), joints90

    def _joints_within(self, pose: PoseEstimate, deviations: Array, truth: Array) -> float:
        """Share of the joints within the 90 % interval of a Student t of such standard deviations (J,); NaN of none."""
        if not len(truth):
            return _NAN
        degrees = POSE_DEGREES_OF_FREEDOM
        reach = np.sqrt(squared_radius(0.9, 1, degrees) * scale_of(deviations**2, degrees))
        return float(np.mean(np.array(self._joint_errors(pose, truth)) <= reach))

    def _joint_errors(self, found: PoseEstimate, truth: Array) -> list[float]:
        """Of each joint against its true value (J,)."""
        return [_joint_error(*one) for one in zip(self.articulation.joints, found.joints, truth, strict=True)]

    def _twins_reported(self, modes: Sequence[Mode], alike: Poses) -> bool | None:
        """Whether modes stand near the truth (or a rotation symmetry of it) and near a mirror twin of it."""
        if not self._mirrored.any():
            return None
        gaps = np.array([_angles_deg(mode.pose, alike, self._axes) for mode in modes]).reshape(-1, len(alike))
        near = np.any(gaps < TWIN_FOUND_DEG, axis=0)
        return bool(near[self._mirrored].any() and near[~self._mirrored].any())


def ambiguity(case: Case, held: Articulation) -> tuple[Symmetry, ...]:
    """The listed symmetries of the body, as they stand; else what was found with the model, joints mapped."""
    if case.symmetries is None:
        return held_symmetries(case.model.twins, case.model.articulation, held)
    n = held.n_joints
    return tuple(make_symmetry(matrix, np.zeros(3), (1.0,) * n, (0.0,) * n) for matrix in case.symmetries)


def region_of(off: Array, covariance: Array) -> float:
    """Probability of the region of a Student t about a rotation (``model.prior.POSE_DEGREES_OF_FREEDOM``) that reaches
    ``off`` (3), of covariance (3, 3) in the same unit; NaN where that is none.
    """
    degrees = POSE_DEGREES_OF_FREEDOM
    if not np.isfinite(covariance).all() or np.linalg.eigvalsh(covariance).min() <= 0:
        return _NAN
    square = off @ np.linalg.solve(scale_of(covariance, degrees), off)
    return share_within(float(square), 3, degrees)


def _angles_deg(found: PoseEstimate, alike: Poses, axes: Sequence[Axis]) -> Array:
    return np.rad2deg(angle_apart(found.quaternion[None], alike.quaternion, axes))


def _joint_error(joint: Joint, found: float, truth: float) -> float:
    if joint.kind == "revolute" and joint.period is None:  # a value one turn on is the same place
        return abs((found - truth + 180.0) % _FULL_TURN_DEG - 180.0)
    return joint_error(joint, found, truth)


def _batch(pose: PoseEstimate) -> Poses:
    return Poses(pose.quaternion[None], pose.position[None], np.log([pose.scale]), np.asarray(pose.joints)[None])
