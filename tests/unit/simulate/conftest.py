"""The demo satellite, loaded once."""

import pytest

from gpu.mesh import load_mesh
from service.models.articulations import read_joints
from service.simulate.satellite import demo_satellite


@pytest.fixture(scope="session")
def demo():
    data = demo_satellite()
    mesh = load_mesh(data, "glb")
    return data, mesh, read_joints(data, "glb", mesh).articulation
