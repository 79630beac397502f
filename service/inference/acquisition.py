"""Where to start when nothing is known: rotations over the whole space, placed onto the evidence.

Position and scale of a rotation need no search: the silhouette's area and centroid must be those of the light in
the frame. What is left to search is the rotation and the joints.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.inference.domain import Domain
from service.inference.rotations import spread_rotations
from service.inference.state import Array, Poses

Map = NDArray[np.float32]
ScoreMaps = Callable[[Poses, Map], Array]  # (N poses, (K, H, W) maps) -> (N, K) sums under the silhouettes

_SCALE_JITTER = 0.12  # log scale: parts of the body may be unlit, so the light's area is a rough guide
_POSITION_JITTER = 0.04  # of the evidence's extent


@dataclass(frozen=True)
class Evidence:
    """The light that may be the object: its area, centroid and root-mean-square radius, and the sum of its map."""

    area_px: float
    centroid: Array  # (2,)
    radius_px: float
    light_nats: float = 0.0


def find_evidence(log_ratio: Map) -> Evidence | None:
    """The pixels in favour of the object, without specks; None where there are none.

    Stars and noise make small components: those below a twentieth of the largest one are left out, unless they
    are close to it (a dim part may be broken into pieces).
    """
    from scipy import ndimage  # the web process, which restarts fast, never comes here

    labels, count = ndimage.label(log_ratio > 0, structure=np.ones((3, 3)))
    if count == 0:
        return None
    areas = np.bincount(labels.ravel())[1:]
    largest = int(np.argmax(areas))
    kept = areas >= max(4.0, 0.05 * areas[largest])
    kept[largest] = True
    y, x = np.nonzero(np.concatenate([[False], kept])[labels])
    centroid = np.array([x.mean() + 0.5, y.mean() + 0.5])
    radius = float(np.sqrt(np.mean((x + 0.5 - centroid[0]) ** 2 + (y + 0.5 - centroid[1]) ** 2)))
    return Evidence(float(len(x)), centroid, max(radius, 0.5), float(np.sum(log_ratio[y, x], dtype=np.float64)))


def draw_joints(rng: np.random.Generator, domain: Domain, count: int) -> Array:
    """(N, J) joints over their ranges: a Kronecker sequence shifted at random, low discrepancy."""
    n = domain.articulation.n_joints
    least, greatest = domain.joint_bounds
    root = 2.0
    for _ in range(50):  # of x^(n + 1) = x + 1: golden for one joint, plastic for two, and so on
        root = (1.0 + root) ** (1.0 / (n + 1))
    steps = np.mod(root ** -np.arange(1.0, n + 1), 1.0)
    unit = np.mod(rng.random(n) + np.arange(count)[:, None] * steps, 1.0)
    return least + unit[rng.permutation(count)] * (greatest - least)


def place(rng: np.random.Generator, domain: Domain, evidence: Evidence, score_maps: ScoreMaps, count: int) -> Poses:
    """``count`` poses that cover all rotations and joints, each with the evidence's area and centroid."""
    poses = Poses(
        spread_rotations(rng, count),
        np.tile([domain.width / 2, domain.height / 2], (count, 1)),
        np.full(count, np.log(0.35 * min(domain.width, domain.height) / domain.radius)),
        draw_joints(rng, domain, count),
    )
    area, offset = _silhouette_moments(poses, domain, score_maps)
    low, high = domain.log_scale_bounds
    grow = 0.5 * np.log(evidence.area_px / np.maximum(area, 1.0)) + _SCALE_JITTER * rng.standard_normal(count)
    log_scale = np.clip(poses.log_scale + grow, low, high)
    scale_ratio = np.exp(log_scale - poses.log_scale)
    jitter = _POSITION_JITTER * evidence.radius_px * rng.standard_normal((count, 2))
    position = evidence.centroid - offset * scale_ratio[:, None] + jitter
    return Poses(poses.quaternion, np.clip(position, 0, (domain.width, domain.height)), log_scale, poses.joints)


def _silhouette_moments(poses: Poses, domain: Domain, score_maps: ScoreMaps) -> tuple[Array, Array]:
    """(N,) area and (N, 2) centroid relative to the pose's position, by summing 1, x and y under silhouettes."""
    x = np.arange(domain.width, dtype=np.float32) + np.float32(0.5 - domain.width / 2)
    y = np.arange(domain.height, dtype=np.float32) + np.float32(0.5 - domain.height / 2)
    maps = np.stack([np.ones((domain.height, domain.width), np.float32), *np.meshgrid(x, y)])
    sums = score_maps(poses, maps)
    area = sums[:, 0]
    return area, sums[:, 1:] / np.maximum(area, 1.0)[:, None]
