"""A cube, and the slow scorer for it: what the filter's tests look at."""

from collections.abc import Callable

import numpy as np
import pytest

from gpu.mesh import Mesh, assemble
from gpu.raw_part import RawPart
from gpu.reference import reference_scores
from service.inference.articulation import Articulation, part_transforms
from service.inference.pose import rotation_matrices
from service.inference.state import Poses


@pytest.fixture(scope="session")
def block() -> Mesh:
    """A closed box of 2 x 1.2 x 0.6 units about the origin."""
    vertices = np.array([[x, y, z] for x in (-1, 1) for y in (-0.6, 0.6) for z in (-0.3, 0.3)], dtype=float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    return assemble([RawPart("block", vertices, faces)])


@pytest.fixture(scope="session")
def rigid() -> Articulation:
    """The block has no joints."""
    return Articulation(("block",))


@pytest.fixture(scope="session")
def score_maps(block, rigid) -> Callable[[Poses, np.ndarray], np.ndarray]:
    """``score_maps`` of ``step`` by the reference scorer."""

    def score(poses: Poses, maps: np.ndarray) -> np.ndarray:
        return reference_scores(block, part_transforms(rigid, poses), maps)

    return score


HALF_EDGES = np.diag([1.0, 0.6, 0.3])


@pytest.fixture(scope="session")
def quick_score_maps() -> Callable[[Poses, np.ndarray], np.ndarray]:
    """The same for many poses at once: the outline of a box is a zonogon.

    A point lies in it where, for the projection of every edge direction e, its distance from the line along e
    through the centre is at most that of the other half edges together.
    """

    def score(poses: Poses, maps: np.ndarray) -> np.ndarray:
        height, width = maps.shape[1:]
        x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        edges = np.exp(poses.log_scale)[:, None, None] * (HALF_EDGES @ rotation_matrices(poses.quaternion).mT)
        inside = np.ones((len(poses), height * width), bool)
        for i in range(3):
            normal = np.stack([-edges[:, i, 1], edges[:, i, 0]], axis=1)
            reach = np.abs(np.einsum("nij,nj->ni", edges[:, :, :2], normal)).sum(axis=1)
            centre = np.sum(normal * poses.position, axis=1)
            distance = normal[:, :1] * x.ravel() + normal[:, 1:] * y.ravel() - centre[:, None]
            inside &= np.abs(distance) <= reach[:, None]
        return inside @ maps.reshape(len(maps), -1).T.astype(np.float64)

    return score
