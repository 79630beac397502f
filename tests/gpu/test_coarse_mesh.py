"""Surface groups, and meshes no finer than a picture shows."""

import numpy as np
import pytest
from gpu_cases import box, mesh_of, shared_mesh, sphere, transforms

from gpu.coarse_mesh import coarse_mesh
from gpu.silhouettes import silhouettes
from gpu.surface_groups import face_areas, surface_groups
from gpu.zbuffer import rasterise


def joined(*solids):
    """Several solids as one part."""
    first = np.cumsum([0, *(len(v) for v, _ in solids)])
    return np.vstack([v for v, _ in solids]), np.vstack([f + n for (_, f), n in zip(solids, first, strict=False)])


def split(vertices, faces):
    """The same faces without a shared vertex."""
    return vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)


def test_a_group_is_a_piece_with_all_its_sides_the_largest_first():
    mesh = mesh_of(joined(box((1, 1, 1)), box((4, 4, 0.1), (9, 0, 0)), box((0.5, 0.5, 0.5), (0, 5, 0))))
    groups = surface_groups(mesh)
    assert groups.dtype == np.int32
    assert sorted(np.bincount(groups)) == [12, 12, 12]
    area = np.bincount(groups, weights=face_areas(mesh))
    assert area.argmax() == 0 and (np.diff(area) < 0).all()


def test_pieces_are_told_by_place_and_never_span_parts():
    cube = split(*box())
    assert set(surface_groups(mesh_of(cube))) == {0}
    assert set(surface_groups(mesh_of(cube, box()))) == {0, 1}


@pytest.mark.parametrize("most", [1, 2, 5, 8])
def test_there_are_at_most_so_many_groups_and_the_rest_keep_to_their_part(most):
    boxes = [box((1 + 0.1 * k,) * 3, (4.0 * k, 0, 0)) for k in range(6)]
    mesh = mesh_of(joined(*boxes[:3]), joined(*boxes[3:]))
    groups = surface_groups(mesh, most)
    assert len(set(groups)) == min(most, 6) == groups.max() + 1
    if most >= 2:
        assert all(len(set(mesh.part_of[groups == g])) == 1 for g in set(groups))
    assert np.array_equal(groups, surface_groups(mesh, most))


@pytest.mark.parametrize(("large", "small", "wanted"), [(2, 100, 32), (40, 100, 40), (100, 100, 64), (3, 0, 3)])
def test_pieces_that_have_nearly_all_of_the_area_are_groups_of_their_own(large, small, wanted):
    boxes = [box((1.0,) * 3, (4.0 * k, 0, 0)) for k in range(large)]
    boxes += [box((0.01,) * 3, (4.0 * k, 5, 0)) for k in range(small)]
    groups = surface_groups(mesh_of(joined(*boxes)))
    assert groups.max() + 1 == wanted
    alone = np.bincount(groups, minlength=wanted) == 12
    assert alone.sum() >= wanted - 1 and len(set(groups[: 12 * min(large, 31)])) == min(large, 31)


def test_no_groups_are_refused():
    with pytest.raises(ValueError, match="at least one"):
        surface_groups(mesh_of(box()), 0)


def test_silhouettes_are_the_z_buffers():
    mesh = mesh_of(sphere(8), box((3.0, 0.2, 0.01)))
    given = transforms(np.random.default_rng(2), mesh, 6, 20.0, (50, 50)).astype(np.float64)
    placed = np.stack([mesh.placed(one) for one in given])
    found = silhouettes(placed, mesh.faces, 50)
    wanted = [rasterise(vertices[mesh.faces], 50, 50).face >= 0 for vertices in placed]
    assert np.count_nonzero(found != np.stack(wanted)) <= 2


def test_a_fine_ball_becomes_coarse_and_stays_round():
    mesh = mesh_of(sphere(60))
    groups = (mesh.part_of * 0).astype(np.int32)
    coarse, kept = coarse_mesh(mesh, groups, 30.0)
    assert coarse.n_faces < 0.6 * mesh.n_faces
    assert len(kept) == coarse.n_faces
    radius = np.linalg.norm(coarse.parts[0].vertices, axis=1) / mesh.radius
    assert radius.min() > 0.98 and radius.max() < 1.02
    finer, _ = coarse_mesh(mesh, groups, 120.0)
    assert coarse.n_faces < finer.n_faces


def test_small_parts_stay_as_they_are():
    mesh = mesh_of(box(), sphere(30))
    coarse, _ = coarse_mesh(mesh, surface_groups(mesh), 20.0)
    assert np.array_equal(coarse.parts[0].vertices, mesh.parts[0].vertices)
    assert [part.name for part in coarse.parts] == [part.name for part in mesh.parts]
    assert coarse.n_faces < mesh.n_faces


@pytest.mark.parametrize("name", ["hubble", "iss", "suomi_npp", "topex_poseidon", "tdrs", "shuttle_orbiter"])
def test_real_bodies_keep_silhouette_and_groups(shared, name):
    mesh = shared_mesh(shared / "data" / "meshes" / f"{name}.glb")
    groups = surface_groups(mesh)
    coarse, kept = coarse_mesh(mesh, groups, 31.0)
    assert coarse.n_faces < 0.6 * mesh.n_faces
    assert set(kept) == set(groups)
    before, after = (
        np.bincount(g, weights=face_areas(m), minlength=groups.max() + 1) for g, m in ((groups, mesh), (kept, coarse))
    )
    assert after[0] == pytest.approx(before[0], rel=0.2)
    given = transforms(np.random.default_rng(3), mesh, 12, 62.0, (128, 128), 0.0).astype(np.float64)
    one, two = (silhouettes(np.stack([m.placed(t) for t in given]), m.faces, 128) for m in (mesh, coarse))
    assert (one & two).sum() / (one | two).sum() > 0.96
