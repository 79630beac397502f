"""A cube, and the slow scorer for it: what the filter's tests look at."""

from collections.abc import Callable

import numpy as np
import pytest

from gpu.mesh import Mesh, assemble
from gpu.raw_part import RawPart
from gpu.reference import reference_scores
from service.inference.articulation import Articulation, part_transforms
from service.inference.model import search
from service.inference.state import Poses


@pytest.fixture
def small_banks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Banks of a third of the templates, which draw in a third of the time."""
    monkeypatch.setattr(search, "BANK_SIZE", 1500)


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
def score_of(block, rigid) -> Callable[[np.ndarray], Callable[[Poses], np.ndarray]]:
    """From a map (H, W) to ``score`` of ``step``, by the reference scorer."""

    def of(log_ratio: np.ndarray) -> Callable[[Poses], np.ndarray]:
        return lambda poses: reference_scores(block, part_transforms(rigid, poses), log_ratio[None])[:, 0]

    return of
