"""How many symmetries of a body are kept, and that those are a group."""

import numpy as np
import pytest

from service.models import symmetry
from service.models.symmetry import find_symmetries, model_symmetries
from service.simulate.primitives import box, cone
from tests.unit.models.test_symmetry import looks_alike, mesh_of, rigid


def form_a_group(symmetries) -> bool:
    matrices = [np.eye(3), *(np.asarray(s.matrix) for s in symmetries)]
    products = (a @ b for a in matrices for b in matrices)
    return all(min(np.abs(product - c).max() for c in matrices) < 1e-9 for product in products)


@pytest.mark.parametrize(("most", "count"), [(48, 47), (16, 15)])
def test_a_cube_has_47_symmetries_and_where_fewer_are_kept_they_form_a_group(monkeypatch, most, count):
    monkeypatch.setattr(symmetry, "MAX_ELEMENTS", most)
    mesh = mesh_of(cube=box((2, 2, 2)))
    found = model_symmetries(mesh, rigid(mesh))
    assert len(found.symmetries) == count
    assert any("more symmetries" in warning for warning in found.warnings) == (count < 47)
    assert form_a_group(found.symmetries)
    assert looks_alike(mesh, rigid(mesh), found.symmetries) > 0.98


def test_of_a_drum_quarter_turns_are_enough():
    mesh = mesh_of(drum=cone(1.0, 1.0, 2.0, 48))
    found = find_symmetries(mesh, rigid(mesh))
    assert len(found) == 15
    assert form_a_group(found)
    assert looks_alike(mesh, rigid(mesh), found) > 0.97
