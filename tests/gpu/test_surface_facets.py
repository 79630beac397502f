"""What of a piece lies in about one plane, or bends smoothly."""

import numpy as np
import trimesh
from gpu_cases import box, mesh_of, sphere

from gpu.surface_facets import surface_facets
from gpu.surface_groups import MOST, face_areas, surface_groups


def facets(mesh):
    groups = surface_groups(mesh)
    return (groups, *surface_facets(mesh, groups))


def normals(mesh) -> np.ndarray:
    p, q, r = np.moveaxis(np.vstack([part.vertices for part in mesh.parts])[mesh.faces], 1, 0)
    cross = np.cross(q - p, r - p)
    return cross / np.linalg.norm(cross, axis=1)[:, None]


def test_a_box_has_six_and_its_pieces_are_told():
    mesh = mesh_of(box((1.0, 2.0, 3.0)), box((2.0, 0.5, 1.0), (5, 0, 0)))
    groups, facet, group = facets(mesh)
    assert group.tolist() == [0] * 6 + [1] * 6
    assert np.array_equal(group[facet], groups)
    for k in range(12):
        assert np.ptp(np.abs(normals(mesh)[facet == k]), axis=0).max() < 1e-6
        assert (facet == k).sum() == 2


def test_a_panel_has_two_sides_and_what_is_thin_goes_with_the_larger():
    mesh = mesh_of(box((2.0, 4.0, 0.01)))
    _, facet, group = facets(mesh)
    assert len(group) == 2
    area = np.bincount(facet, weights=face_areas(mesh))
    assert area.min() > 0.49 * area.sum()


def test_what_bends_smoothly_is_one():
    tube = trimesh.creation.cylinder(1.0, 3.0, sections=24)
    mesh = mesh_of((np.asarray(tube.vertices), np.asarray(tube.faces)))
    _, facet, group = facets(mesh)
    assert group.tolist() == [0, 0, 0]  # the side, and two ends
    assert (facet == 0).sum() == 48
    assert facets(mesh_of(sphere(12)))[2].tolist() == [0]


def test_faces_wound_the_other_way_and_edges_of_three_faces_do_not_matter():
    vertices, faces = box((1.0, 2.0, 3.0))
    turned = faces.copy()
    turned[::3] = turned[::3, ::-1]
    _, facet, group = facets(mesh_of((vertices, turned)))
    assert len(group) == 6 and (np.bincount(facet) == 2).all()
    fin = np.vstack([faces, [[*faces[0, :2], len(vertices)]]])
    _, facet, group = facets(mesh_of((np.vstack([vertices, [[9.0, 9.0, 9.0]]]), fin)))
    assert set(group) == {0} and facet.max() == len(group) - 1


def test_there_are_no_more_than_groups_may_be():
    mesh = mesh_of(*[box((1.0, 1.0, 1.0 + 0.1 * k), (4.0 * k, 0, 0)) for k in range(12)])
    groups, facet, group = facets(mesh)
    assert len(group) == facet.max() + 1 == MOST
    assert np.array_equal(group[facet], groups)
    assert (np.diff(group) >= 0).all() and set(group) == set(range(12))


def test_of_a_body_of_very_many_boxes_the_small_ones_stay_whole():
    mesh = mesh_of(box((4.0, 4.0, 4.0)), *[box((0.2,) * 3, (5.0 + k, 0, 0)) for k in range(9)])
    _, _, group = facets(mesh)
    assert np.bincount(group).tolist() == [6] + [1] * 9
