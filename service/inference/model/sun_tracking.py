"""Joints that are turned so that a panel faces the Sun (docs/model.md, section 1): a prior on their values."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from service.inference.articulation import Articulation, part_transforms
from service.inference.pose import retract
from service.inference.state import Array, Poses

_ROUNDS = 6  # numerical: of joints that carry each other, one after the other
_STEP_RAD, _STEP_DEG = 0.01, 0.5  # numerical: of differences


@dataclass(frozen=True)
class SunTracking:
    """K hinges, those that carry others first. What is seen of a panel's two sides is taken to be the same."""

    articulation: Articulation
    columns: tuple[int, ...]  # of the joints
    panels: tuple[int, ...]  # a part that each of them turns
    normals: Array  # (K, 3) of these parts' surfaces, at rest
    sigma_deg: float

    def off(self, poses: Poses, suns: Array) -> Array:
        """(N, K) degrees that each joint's value lacks of facing the Sun, as far as its range lets it."""
        return np.stack([self._off(k, poses, suns) for k in range(len(self.columns))], axis=1)

    def log_density(self, poses: Poses, suns: Array) -> Array:
        """(N,) but for the Gaussians' height."""
        return np.asarray(-0.5 * np.sum((self.off(poses, suns) / self.sigma_deg) ** 2, axis=1))

    def slopes(self, pose: Poses, sun: Array) -> tuple[Array, Array]:
        """(K,) of one pose: ``off`` over its sigma; and (K, 6 + J) how it changes with the pose's tangent."""
        d = 6 + pose.joints.shape[1]
        steps = np.repeat([_STEP_RAD, 0.0, _STEP_DEG], [3, 3, d - 6])
        moving = np.flatnonzero(steps)
        moves = np.zeros((2, len(moving), d))
        moves[0, np.arange(len(moving)), moving] = steps[moving]
        moves[1] = -moves[0]
        around = retract(pose[np.zeros(2 * len(moving), dtype=np.intp)], moves.reshape(-1, d))
        there = self.off(around, np.tile(sun, (2 * len(moving), 1))).reshape(2, len(moving), -1) / self.sigma_deg
        out = np.zeros((len(self.columns), d))
        out[:, moving] = ((there[0] - there[1]) / (2 * steps[moving, None])).T
        return self.off(pose, sun[None])[0] / self.sigma_deg, out

    def pointed(self, poses: Poses, suns: Array) -> Poses:
        """The same with these joints as they should be."""
        for _ in range(_ROUNDS if len(self.columns) > 1 else 1):
            for k, column in enumerate(self.columns):
                joints = poses.joints.copy()
                joints[:, column] += self._off(k, poses, suns)
                poses = replace(poses, joints=joints)
        return poses

    def side_deg(self, k: int) -> float:
        """Degrees of a joint from one side of its panel to the other."""
        return abs(180.0 / self._ratio(k))

    def _ratio(self, k: int) -> float:
        stages = self.articulation.joints[self.columns[k]].stages
        return next(one.ratio for one in stages if self.articulation.parts[self.panels[k]] in one.parts)

    def _off(self, k: int, poses: Poses, suns: Array) -> Array:
        """(N,) of one joint. As it turns, its panel's normal runs round a cone: three places tell which."""
        joint, column = self.articulation.joints[self.columns[k]], self.columns[k]
        ratio, half = self._ratio(k), self.side_deg(k)
        quarter = 90.0 / ratio
        here, aside, behind = (self._normals(k, poses, quarter * turn) for turn in (0, 1, 2))
        middle = 0.5 * (here + behind)
        across = np.sum((here - middle) * suns, axis=1), np.sum((aside - middle) * suns, axis=1)
        best = poses.joints[:, column] + np.rad2deg(np.arctan2(across[1], across[0])) / ratio
        near = best - half * np.round((best - poses.joints[:, column]) / half)
        if joint.maximum - joint.minimum < half:  # the nearest that the joint reaches, on either side
            near = best - half * np.round((best - 0.5 * (joint.minimum + joint.maximum)) / half)
            near = np.clip(near, joint.minimum, joint.maximum)
        return np.asarray(near - poses.joints[:, column])

    def _normals(self, k: int, poses: Poses, more_deg: float) -> Array:
        """(N, 3) of a panel, in camera axes, with its joint so much further."""
        joints = poses.joints.copy()
        joints[:, self.columns[k]] += more_deg
        moved = part_transforms(self.articulation, replace(poses, joints=joints))[:, self.panels[k], :, :3]
        out = moved.astype(np.float64) @ self.normals[k]
        return np.asarray(out / np.linalg.norm(out, axis=1, keepdims=True))
