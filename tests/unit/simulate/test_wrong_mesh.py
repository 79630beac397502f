"""Bodies that are not quite their mesh."""

import numpy as np
import pytest
import trimesh

from gpu.mesh import Mesh, Part
from service.simulate.wrong_mesh import misshapen


def rows_of_boxes(boxes=400):
    """A part of many small boxes beside a large one, and a part of one box."""
    small = [trimesh.creation.box([0.1] * 3).apply_translation((0.3 * k, 0, 0)) for k in range(boxes)]
    large = trimesh.creation.box([10.0] * 3).apply_translation((0, 40, 0))
    whole, single = trimesh.util.concatenate([large, *small]), trimesh.creation.box([2.0] * 3)
    parts = [Part(n, np.asarray(s.vertices), s.faces.astype(np.int32)) for n, s in (("a", whole), ("b", single))]
    return Mesh(tuple(parts), (0, 0, 0), (1, 1, 1), 60.0, True)


def test_without_an_error_it_is_the_mesh():
    mesh = rows_of_boxes(3)
    assert misshapen(mesh, np.random.default_rng(1), 0.0) is mesh


@pytest.mark.parametrize("error", [0.02, 0.1])
def test_pieces_are_stretched_moved_or_missing_as_told(error):
    mesh = rows_of_boxes()
    body = misshapen(mesh, np.random.default_rng(2), error)
    before, after = mesh.parts[0].vertices[8:].reshape(-1, 8, 3), body.parts[0].vertices[8:].reshape(-1, 8, 3)
    stretch = np.log(np.ptp(after, axis=1) / np.ptp(before, axis=1))
    assert stretch.std() == pytest.approx(error, rel=0.1)
    shift = after.mean(axis=1) - before.mean(axis=1)
    assert shift.std() == pytest.approx(0.2 * error * mesh.radius, rel=0.1)
    assert len(body.parts[0].faces) == pytest.approx(12 + 0.75 * 12 * 400, rel=0.1)


def test_every_part_keeps_its_largest_piece_and_its_name():
    mesh = rows_of_boxes(3)
    for seed in range(20):
        body = misshapen(mesh, np.random.default_rng(seed), 0.3)
        assert [part.name for part in body.parts] == ["a", "b"]
        assert len(body.parts[1].faces) == 12
        assert set(mesh.parts[0].faces[:12].ravel()) <= set(body.parts[0].faces.ravel())


def test_the_same_seed_makes_the_same_body():
    one, other = (misshapen(rows_of_boxes(5), np.random.default_rng(7), 0.05) for _ in range(2))
    assert all(np.array_equal(a.vertices, b.vertices) for a, b in zip(one.parts, other.parts, strict=True))
