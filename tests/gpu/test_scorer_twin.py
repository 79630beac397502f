"""Every kernel against its slow, obvious twin."""

import functools

import numpy as np
import pytest
from gpu_cases import MESHES, SHAPE, a_map, box, mesh_of, relative_error, shared_mesh, soup, sphere, transforms
from hypothesis import given, settings
from hypothesis import strategies as st

from gpu import outline_kernels
from gpu.clusters import build_table
from gpu.device import find_devices
from gpu.fill import FillScorer
from gpu.outline import OutlineScorer
from gpu.reference import reference_scores, silhouette_mask
from gpu.scorer import ReferenceScorer

KERNELS = ("cpu", "gpu")
BACKENDS = ("fill", *KERNELS)


def open_outline(mesh, kernel):
    usable = [report for report in find_devices() if report.rejected is None]
    if not usable:
        pytest.skip("no OpenCL device answers")
    return FillScorer(mesh, usable[0]) if kernel == "fill" else OutlineScorer(mesh, usable[0], kernel)


def assert_twins(mesh, poses, values, tolerance=1e-4):
    """All kernels at once: the reference takes most of the time."""
    expected = reference_scores(mesh, poses, np.stack([values, np.abs(values)]))
    for kernel in BACKENDS:
        scores = open_outline(mesh, kernel).score(poses, values)
        assert relative_error(scores, expected[:, 0], expected[:, 1]) < tolerance, kernel


@functools.cache
def real_case(path):
    """A spacecraft, particles, a map, and what the reference says of the map, of its magnitude and of the areas."""
    mesh, rng, shape = shared_mesh(path), np.random.default_rng(5), (256, 256)
    poses, values = transforms(rng, mesh, 12, 110.0, shape), a_map(rng, shape)
    expected = reference_scores(mesh, poses, np.stack([values, np.abs(values), np.ones(shape, np.float32)]))
    return mesh, poses, values, expected


@pytest.mark.parametrize("kernel", BACKENDS)
@pytest.mark.parametrize("name", MESHES)
def test_agrees_on_real_spacecraft(shared, name, kernel):
    mesh, poses, values, expected = real_case(shared / "data" / "meshes" / f"{name}.glb")
    scorer = open_outline(mesh, kernel)
    assert relative_error(scorer.score(poses, values), expected[:, 0], expected[:, 1]) < 1e-4
    ones = np.ones((1, *values.shape), np.float32)
    assert np.array_equal(scorer.score_many(poses, ones), expected[:, 2:])


@pytest.mark.parametrize(("radius_px", "spread_px"), [(1.5, 20.0), (20.0, 5.0), (60.0, 60.0), (3000.0, 500.0)], ids=str)
def test_any_size_and_place(radius_px, spread_px):
    mesh = mesh_of(sphere(), box(centre=(1.5, 0, 0)), box((3, 0.1, 1), (0, 1.6, 0)))
    rng = np.random.default_rng(6)
    poses = transforms(rng, mesh, 40, radius_px, spread_px=spread_px)
    assert_twins(mesh, poses, a_map(rng))


def test_open_flipped_and_non_manifold():
    rng = np.random.default_rng(7)
    vertices, faces = sphere(6)
    holes = faces[rng.random(len(faces)) < 0.7]
    flipped = np.where(rng.random(len(holes))[:, None] < 0.5, holes[:, ::-1], holes)
    fins = np.array([[0, k, k + 1] for k in range(1, 20)])
    mesh = mesh_of((vertices, np.vstack([flipped, fins])), (vertices * 0.5 + 0.7, flipped))
    assert_twins(mesh, transforms(rng, mesh, 40, 35.0), a_map(rng))


def test_hidden_pieces_change_nothing():
    rng = np.random.default_rng(8)
    inside = [box((0.2, 0.3, 0.1), rng.uniform(-0.5, 0.5, 3)) for _ in range(30)]
    through = [box((0.1, 0.1, 2.5), rng.uniform(-0.6, 0.6, 3)) for _ in range(10)]
    pieces = [sphere(10, 1.0), box((3, 2, 0.05), (0, 0, 0.7)), *inside, *through]
    starts = np.cumsum([0] + [len(v) for v, _ in pieces])
    one = np.vstack([v for v, _ in pieces]), np.vstack([f + s for (_, f), s in zip(pieces, starts[:-1], strict=True)])
    mesh = mesh_of(one)
    assert_twins(mesh, transforms(rng, mesh, 150, 30.0), a_map(rng))


def test_more_crossings_in_a_row_than_there_is_room_for(monkeypatch):
    crowded, score = [], OutlineScorer._score_crowded
    monkeypatch.setattr(OutlineScorer, "_score_crowded", lambda *given: crowded.append(given[0]) or score(*given))
    rng = np.random.default_rng(9)
    mesh = mesh_of(soup(rng, 900, 300))
    tables = []

    def built_once(*given):  # it takes seven seconds
        if not tables:
            tables.append(build_table(*given))
        return tables[0]

    monkeypatch.setattr(outline_kernels, "build_table", built_once)
    poses, values = transforms(rng, mesh, 1, 12.0), a_map(rng)
    assert_twins(mesh, poses, values)
    assert len(crowded) == 1 and crowded[0]._by_item is not None  # a CPU's, whose rows are of a size


@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), n_faces=st.integers(1, 25), n_vertices=st.integers(3, 12))
def test_any_small_mesh(seed, n_faces, n_vertices):
    rng = np.random.default_rng(seed)
    mesh = mesh_of(*(soup(rng, n_faces, n_vertices) for _ in range(rng.integers(1, 4))))
    poses = transforms(rng, mesh, 3, rng.uniform(2, 80), spread_px=40.0)
    assert_twins(mesh, poses, a_map(rng))


@pytest.mark.parametrize("kernel", BACKENDS)
def test_a_count_of_pixels_is_exact(kernel):
    mesh = mesh_of(box((2, 1, 1)))
    ones = np.ones(SHAPE, np.float32)
    pose = np.zeros((1, 1, 3, 4), np.float32)
    pose[0, 0, :, :3] = 20 * np.eye(3)
    pose[0, 0, :2, 3] = 64.25, 48.25  # columns 44.25 .. 84.25, rows 38.25 .. 58.25
    assert open_outline(mesh, kernel).score(pose, ones)[0] == 40 * 20
    assert silhouette_mask(mesh, pose[0], SHAPE).sum() == 40 * 20


@pytest.mark.parametrize("kernel", BACKENDS)
def test_order_and_company_do_not_matter(kernel):
    mesh = mesh_of(sphere(), box(centre=(1, 0, 0)))
    rng = np.random.default_rng(10)
    values, poses = a_map(rng), transforms(rng, mesh, 200, 30.0)
    scorer = open_outline(mesh, kernel)
    together = scorer.score(poses, values)
    assert np.array_equal(scorer.score(poses[::-1], values)[::-1], together)
    assert np.array_equal(np.concatenate([scorer.score(poses[k : k + 7], values) for k in range(0, 200, 7)]), together)


def test_all_give_the_same_bits():
    mesh = mesh_of(sphere(), box(centre=(1, 0, 0)))
    rng = np.random.default_rng(11)
    values, poses = a_map(rng), transforms(rng, mesh, 200, 30.0)
    scorers = [ReferenceScorer(mesh), *(open_outline(mesh, kernel) for kernel in BACKENDS)]
    expected = scorers[0].score(poses, values)
    assert all(np.array_equal(scorer.score(poses, values), expected) for scorer in scorers)


def test_masks_are_the_reference_masks():
    rng = np.random.default_rng(15)
    mesh = mesh_of(sphere(), soup(rng, 20, 12))
    poses = transforms(rng, mesh, 6, 40.0)
    masks = open_outline(mesh, "fill").masks(poses, SHAPE)
    assert all(
        np.array_equal(mask, silhouette_mask(mesh, pose, SHAPE)) for mask, pose in zip(masks, poses, strict=True)
    )


@pytest.mark.parametrize("kernel", BACKENDS)
def test_several_maps_at_once(kernel):
    mesh = mesh_of(sphere(), box(centre=(1, 0, 0)))
    rng = np.random.default_rng(12)
    poses = transforms(rng, mesh, 50, 30.0)
    maps = np.stack([a_map(rng), np.ones(SHAPE, np.float32), *np.indices(SHAPE).astype(np.float32)])
    scorer = open_outline(mesh, kernel)
    together = scorer.score_many(poses, maps)
    assert together.shape == (50, 4)
    for k, values in enumerate(maps):
        assert np.array_equal(together[:, k], scorer.score(poses, values))


def test_tall_and_odd_images():
    mesh = mesh_of(sphere(), box(centre=(1, 0, 0)))
    rng = np.random.default_rng(14)
    for shape in ((1, 1), (17, 3), (5, 300), (301, 63)):
        poses = transforms(rng, mesh, 10, 40.0, shape, 10.0)
        assert_twins(mesh, poses, a_map(rng, shape))
