"""Does a body look the same through a symmetry? Silhouettes from fixed directions decide."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gpu.mesh import Mesh
from service.inference.articulation import Articulation, Joint, Stage, part_transforms
from service.inference.pose import rotation_matrices
from service.inference.state import Array, Poses
from service.inference.symmetry import Symmetry, twin
from service.models.silhouettes import QUICK_SIZE_PX, Masks, Silhouettes, Target, best_displacement, overlap
from service.models.symmetry_group import make_symmetry

# Measured on nine spacecraft and six random sets of views: the symmetries that a tolerant eye lists have a mean
# overlap of at least 0.966 and a least of 0.935; of the other sign matrices, the mean is at most 0.948.
MEAN_OVERLAP = 0.955
LEAST_OVERLAP = 0.92
QUICK_OVERLAP = 0.87  # of the best overlap of points on a coarse grid
JOINT_OVERLAP = 0.90  # of the moving parts alone, which are drawn large
N_VIEWS = 10
_FIRST_VIEWS, _OTHER_VIEWS = slice(0, 3), slice(3, None)
_NEGLIGIBLE_OFFSET = 0.004  # of the radius: half a pixel


class Trials:
    """Silhouettes of one model, and the questions asked of them."""

    def __init__(self, mesh: Mesh, articulation: Articulation) -> None:
        self.mesh, self.articulation = mesh, articulation
        self.rest = articulation.initial
        self._views = Silhouettes(mesh, articulation, N_VIEWS)
        rng = np.random.default_rng(2018)
        low, high = (np.array([getattr(j, end) for j in articulation.joints]) for end in ("minimum", "maximum"))
        self.random = low + rng.random((N_VIEWS, articulation.n_joints)) * (high - low)
        places = {part.name: p for p, part in enumerate(mesh.parts)}
        self._moved = {
            joint.name: tuple(sorted({places[name] for stage in joint.stages for name in stage.parts}))
            for joint in articulation.joints
        }
        self._body = Target(np.zeros(3), self._reach())
        self._seen: dict[tuple[int, ...], tuple[Masks, Masks]] = {}
        self._moving: dict[int, tuple[Poses, Masks]] = {}  # by joint

    @property
    def points(self) -> list[Array]:
        """Per part points spread evenly over its surface, body frame at rest."""
        return self._views.points

    def moved_by(self, joint: Joint) -> tuple[int, ...]:
        """Parts that a joint moves, by position."""
        return self._moved[joint.name]

    def offset(self, matrix: Array, parts: tuple[int, ...]) -> tuple[Array, float] | None:
        """For which offset (3,) the parts at rest look alike through ``matrix``, and the mean overlap; None: for none.

        Where the silhouettes lie beside each other tells how far: scale (R' t)_xy is their displacement.
        """
        target = self._target(parts)
        start = target.centre - matrix @ target.centre
        sketch, drawn = self._at_rest(parts, target)
        poses = self._views.poses(self.rest, target, QUICK_SIZE_PX)
        _, best = best_displacement(sketch, self._views.sketch(self._through(poses, matrix, start), parts))
        if best.mean() < QUICK_OVERLAP:
            return None
        poses = self._views.poses(self.rest, target)
        through = self._through(poses, matrix, start)
        _, best = best_displacement(drawn[_FIRST_VIEWS], self._views.draw(through[_FIRST_VIEWS], parts))
        if best.mean() < MEAN_OVERLAP:
            return None
        masks = self._views.draw(through, parts)
        moved, best = best_displacement(drawn, masks)
        found, offset = overlap(drawn, masks), start
        if best.mean() < MEAN_OVERLAP:
            return None
        step = _fit_offset(through, moved, matrix)
        if np.linalg.norm(step) > _NEGLIGIBLE_OFFSET * target.radius:
            shifted = overlap(drawn, self._views.draw(self._through(poses, matrix, start + step), parts))
            if shifted.mean() > found.mean():
                found, offset = shifted, start + step
        return (offset, float(found.mean())) if _same(found) else None

    def holds(self, symmetry: Symmetry) -> bool:
        """Whether the whole body looks alike through ``symmetry``, at random values of the joints it leaves free."""
        sign, shift = np.asarray(symmetry.joint_sign), np.asarray(symmetry.joint_shift)
        poses = self._views.poses(np.where(sign == 0, shift, self.random), self._body)
        found = np.zeros(0)
        for some in (_FIRST_VIEWS, _OTHER_VIEWS):
            seen = overlap(self._views.draw(poses[some]), self._views.draw(twin(poses[some], symmetry)))
            found = np.concatenate([found, seen])
            if not _same(found):
                return False
        return True

    def joint_overlap(self, j: int, symmetry: Symmetry) -> float:
        """How alike the parts of joint ``j`` alone look through ``symmetry``, at random values of that joint."""
        joint = self.articulation.joints[j]
        parts = self.moved_by(joint)
        if j not in self._moving:
            values = np.tile(self.rest, (N_VIEWS, 1))
            values[:, j] = self.random[:, j]
            poses = self._views.poses(values, self._hinged_target(joint, parts))
            self._moving[j] = poses, self._views.draw(poses, parts)
        poses, drawn = self._moving[j]
        return float(overlap(drawn, self._views.draw(twin(poses, symmetry), parts)).mean())

    def _through(self, poses: Poses, matrix: Array, offset: Array) -> Poses:
        n = self.articulation.n_joints
        return twin(poses, make_symmetry(matrix, offset, (1.0,) * n, (0.0,) * n))

    def _at_rest(self, parts: tuple[int, ...], target: Target) -> tuple[Masks, Masks]:
        if parts not in self._seen:
            sketch = self._views.sketch(self._views.poses(self.rest, target, QUICK_SIZE_PX), parts)
            self._seen[parts] = sketch, self._views.draw(self._views.poses(self.rest, target), parts)
        return self._seen[parts]

    def _target(self, parts: Sequence[int]) -> Target:
        if len(parts) == len(self.mesh.parts):
            return self._body
        vertices = np.vstack([self.mesh.parts[p].vertices for p in parts])
        centre = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        return Target(centre, float(np.linalg.norm(vertices - centre, axis=1).max()))

    def _hinged_target(self, joint: Joint, parts: Sequence[int]) -> Target:
        """The moving parts, seen from a point of their axis so that they stay in the image as they turn."""
        vertices = np.vstack([self.mesh.parts[p].vertices for p in parts])
        middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        centre = np.mean([_nearest_on_axis(stage, middle) for stage in joint.stages], axis=0)
        farthest = max(abs(joint.minimum), abs(joint.maximum)) * max(abs(stage.ratio) for stage in joint.stages)
        slide = farthest if joint.kind == "prismatic" else 0.0
        return Target(centre, float(np.linalg.norm(vertices - centre, axis=1).max()) + slide)

    def _reach(self) -> float:
        """Largest distance of the surface from the origin, at rest and at the random joint values."""
        values = np.vstack([self.rest[None], self.random])
        count = len(values)
        poses = Poses(np.tile([1.0, 0, 0, 0], (count, 1)), np.zeros((count, 2)), np.zeros(count), values)
        return max(
            float(np.linalg.norm(points @ m[:, :3].T + m[:, 3], axis=1).max())
            for transforms in part_transforms(self.articulation, poses).astype(np.float64)
            for points, m in zip(self.points, transforms, strict=True)
        )


def _same(found: Array) -> bool:
    return bool(found.mean() >= MEAN_OVERLAP and found.min() >= LEAST_OVERLAP)


def _fit_offset(through: Poses, moved: Array, matrix: Array) -> Array:
    """(3,) least-squares offset that takes back displacements (N, 2), among those that ``matrix`` leaves open."""
    rows = np.exp(through.log_scale)[:, None, None] * rotation_matrices(through.quaternion)[:, :2]
    allowed = np.eye(3) - matrix  # a fixed point c gives the offset c - S c; there is no glide and no screw
    solved = np.linalg.lstsq((rows @ allowed).reshape(-1, 3), moved.reshape(-1), rcond=1e-6)[0]
    return np.asarray(allowed @ solved)


def _nearest_on_axis(stage: Stage, point: Array) -> Array:
    axis, origin = np.asarray(stage.axis), np.asarray(stage.origin)
    return np.asarray(point if stage.kind == "prismatic" else origin + axis * (axis @ (point - origin)))
