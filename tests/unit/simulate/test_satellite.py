"""The demo satellite: sound geometry, a joint, and no symmetry but the unavoidable one."""

import io
import itertools

import numpy as np
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from service.simulate.primitives import box, cone, dish


def test_every_piece_is_closed_and_turned_outward(demo):
    scene = trimesh.load_scene(io.BytesIO(demo[0]), file_type="glb")
    for geometry in scene.geometry.values():
        assert geometry.is_watertight
        assert geometry.is_winding_consistent
        assert all(piece.volume > 0 for piece in geometry.split())


def test_volumes_are_those_of_the_solids():
    def volume(solid):
        return trimesh.Trimesh(solid.vertices, solid.faces).volume

    assert np.isclose(volume(box((2, 3, 4))), 24)
    assert np.isclose(volume(cone(1, 1, 2, 256)), 2 * np.pi, rtol=1e-3)
    assert np.isclose(volume(cone(1, 0.5, 2, 256)), np.pi * 2 / 3 * 1.75, rtol=1e-3)
    # A paraboloid moved up by t leaves a wall of t times the area of its opening.
    assert np.isclose(volume(dish(1.0, 0.4, 0.05, 256, 40)), 0.05 * np.pi, rtol=2e-2)


def test_the_wing_is_a_joint_about_its_hinge_line(demo):
    _, mesh, articulation = demo
    (joint,) = articulation.joints
    assert (joint.name, joint.kind, joint.period) == ("wing", "revolute", 360.0)
    assert joint.stages[0].parts == ("wing",)
    np.testing.assert_allclose(joint.stages[0].axis, [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(joint.stages[0].origin + np.array(mesh.centre), [0.25, 0.8, 0.35], atol=1e-6)


def test_no_mirror_and_no_half_or_quarter_turn_maps_the_body_onto_itself(demo):
    _, mesh, _ = demo
    points = np.vstack([part.vertices for part in mesh.parts])
    tree = cKDTree(points)
    signs = [np.diag(s) for s in itertools.product([1.0, -1.0], repeat=3)][1:]
    turns = Rotation.create_group("O").as_matrix()
    for matrix in [*signs, *turns]:
        if not np.allclose(matrix, np.eye(3)):
            assert tree.query(points @ matrix.T)[0].max() > 0.1 * mesh.radius
