"""The weighted particles after a frame, as named arrays in pixels of the whole frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from service.inference.params import CameraParams
from service.inference.state import FilterState
from service.workers.codec import decode


@dataclass(frozen=True)
class ParticleSet:
    """A stored state, still packed."""

    index: int
    """Of its frame."""
    packed: bytes
    joint_names: tuple[str, ...]
    camera: CameraParams

    def arrays(self, most: int | None = None) -> dict[str, Any]:
        """orientation (N, 4) w x y z, position_px (N, 2), scale_px, joints (N, J), weights.

        Of more than ``most`` particles, so many are drawn (systematically, so the same every time), each once and with
        the share of the draws that fell on it as its weight.
        """
        state = decode(FilterState, self.packed)
        poses = state.poses
        packed = (poses.quaternion, poses.position, poses.log_scale, poses.joints, state.log_weights)
        quaternion, position, log_scale, joints, log_weights = (np.asarray(part, np.float64) for part in packed)
        arrays = {
            "orientation": quaternion,
            "position_px": position * self.camera.binning + self.camera.origin_px,
            "scale_px": np.exp(log_scale) * self.camera.binning,
            "joints": joints,
        }
        weights = np.exp(log_weights - np.logaddexp.reduce(log_weights))
        if most is None or len(weights) <= most:
            return {**arrays, "weights": weights}
        cumulative = np.cumsum(weights)
        draws = np.searchsorted(cumulative / cumulative[-1], (np.arange(most) + 0.5) / most)
        drawn, counts = np.unique(draws, return_counts=True)
        return {**{name: value[drawn] for name, value in arrays.items()}, "weights": counts / most}
