"""What a step is measured on: a body that stands still before the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpu.bench import COVERED
from gpu.mesh import Mesh
from gpu.reference import silhouette_mask
from service.bench.bodies import articulation_of
from service.inference.articulation import Articulation, part_transforms
from service.inference.domain import Domain
from service.inference.motion import diffusion
from service.inference.params import PriorParams, SessionConfig
from service.inference.pose import retract
from service.inference.state import FilterState, Poses

INTERVAL_S = 0.1


@dataclass(frozen=True)
class StepScene:
    """A body that stands still before the camera: every frame is as probable as the one before."""

    mesh: Mesh
    articulation: Articulation
    domain: Domain
    truth: Poses  # a batch of one
    log_ratio: NDArray[np.float32]

    def near_truth(self, rng: np.random.Generator, count: int, config: SessionConfig) -> FilterState:
        """Particles of equal weight about the truth, as far apart as an interval's jitter makes them."""
        deviation = diffusion(config.motion, self.domain) * np.sqrt(INTERVAL_S)
        everywhere = Poses(*(np.repeat(a, count, axis=0) for a in vars(self.truth).values()))
        poses = retract(everywhere, rng.standard_normal((count, len(deviation))) * deviation)
        level = np.full(count, -np.log(count))
        return FilterState(poses, level, np.zeros((count, self.domain.n_tangent)), 0, 0.0, "tracking")


def step_scene(mesh: Mesh, size_px: int, seed: int) -> StepScene:
    """The body in a pose drawn at random, its bounding sphere's disc as large as half of the image."""
    rng = np.random.default_rng([seed, mesh.n_faces, size_px])
    articulation = articulation_of(mesh)
    quaternion = rng.standard_normal((1, 4))
    truth = Poses(
        quaternion / np.linalg.norm(quaternion),
        np.full((1, 2), 0.5 * size_px),
        np.array([np.log(size_px * np.sqrt(COVERED / np.pi) / mesh.radius)]),
        articulation.initial[None],
    )
    seen = silhouette_mask(mesh, part_transforms(articulation, truth)[0], (size_px, size_px))
    noise = 0.3 * rng.standard_normal(seen.shape)
    log_ratio = np.asarray(np.where(seen, 2.0, -1.0) + noise, dtype=np.float32)
    log_ratio.flags.writeable = False  # so that it is kept on the device
    domain = Domain(size_px, size_px, mesh.radius, articulation, PriorParams())
    return StepScene(mesh, articulation, domain, truth, log_ratio)
