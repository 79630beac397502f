"""The scorers' benchmark: who is measured, on what, and that a wrong scorer is found out."""

import numpy as np
import pytest
from gpu_cases import box, mesh_of, sphere

from gpu import scorer as scorers
from gpu.bench import COVERED, Contestant, Plan, bench_scorers, contestants, edge_band, scene, uniform_poses
from gpu.errors import DeviceError, DeviceLostError, ScorerError
from gpu.reference import silhouette_mask
from gpu.scorer import ReferenceScorer
from service.bench.bodies import articulation_of, body_of
from service.bench.opencv_loop import opencv_contestant

TINY = Plan(sizes_px=(32, 64), repeats=2, call_s=1e-4, most_particles=8, checked=3)


@pytest.fixture
def mesh():
    return mesh_of(sphere(4), box(centre=(1.5, 0, 0)))


class Shifted(ReferenceScorer):
    """Wrong by a constant."""

    name = "shifted"

    def score(self, part_transforms, log_ratio):
        return super().score(part_transforms, log_ratio) + 1.0


class Dying(ReferenceScorer):
    """Works once, then its device is gone."""

    name = "dying"
    calls = 0

    def score(self, part_transforms, log_ratio):
        self.calls += 1
        if self.calls > 1:
            raise DeviceLostError("the device is gone")
        return super().score(part_transforms, log_ratio)


def broken(mesh):
    raise DeviceError("no such device")


def test_every_backend_that_the_facade_offers_is_measured(mesh):
    figures = bench_scorers(contestants(), [mesh], TINY)
    offered = set(scorers.BACKENDS) - {"auto"}
    assert {row.backend for row in figures.rows} | set(figures.absent) == offered
    for row in figures.rows:
        assert row.agrees, row
        assert row.us_per_particle >= row.us_least > 0
        assert 1 <= row.particles <= TINY.most_particles
    assert {(row.faces, row.size_px) for row in figures.rows} == {(mesh.n_faces, 32), (mesh.n_faces, 64)}


def test_a_wrong_scorer_is_told(mesh):
    entries = [Contestant("right", ReferenceScorer), Contestant("wrong", Shifted)]
    figures = bench_scorers(entries, [mesh], TINY)
    assert {row.agrees for row in figures.rows if row.backend == "right"} == {True}
    assert {row.agrees for row in figures.rows if row.backend == "wrong"} == {False}


def test_one_that_cannot_be_opened_or_dies_does_not_stop_the_others(mesh):
    entries = [Contestant("none", broken), Contestant("dying", Dying), Contestant("right", ReferenceScorer)]
    figures = bench_scorers(entries, [mesh, mesh_of(box())], TINY)
    assert [row.backend for row in figures.rows] == ["right"] * 4
    assert figures.absent == {"none": "no such device", "dying": "the device is gone"}


def test_unknown_backends_are_refused():
    with pytest.raises(ScorerError, match="abacus"):
        contestants(["abacus"])


def test_bodies_are_whole_and_cover_half_of_the_image(mesh):
    size_px = 200
    poses = uniform_poses(np.random.default_rng(0), mesh, 50, size_px)
    radius_px = mesh.radius * np.linalg.norm(poses[:, 0, 0, :3], axis=1)
    assert np.allclose(np.pi * radius_px**2, COVERED * size_px**2, rtol=1e-5)
    alone = mesh_of(sphere(6))
    for pose in uniform_poses(np.random.default_rng(0), alone, 5, size_px):
        moved = pose.copy()
        moved[:, :2, 3] += 300
        assert silhouette_mask(alone, pose[None, 0], (size_px, size_px)).sum() == pytest.approx(
            silhouette_mask(alone, moved[None, 0], (1000, 1000)).sum(), rel=1e-3
        )


def test_the_edge_band_of_a_square():
    mask = np.zeros((9, 9), bool)
    mask[2:7, 2:7] = True
    band = edge_band(mask)
    assert band.sum() == 49 - 9
    assert not band[3:6, 3:6].any()
    assert not edge_band(np.ones((4, 4), bool)).any()


def test_the_opencv_loop_differs_along_the_edge_only(mesh):
    plan = Plan(most_particles=20, checked=20)
    now = scene(mesh, 96, plan)
    scores = opencv_contestant().open(mesh).score(now.poses, now.log_ratio)
    assert np.all(np.abs(scores - now.expected) < 0.6 * now.edge)


@pytest.mark.parametrize("faces", [1_000, 7_000, 18_000])
def test_made_up_bodies_are_closed_and_of_the_wanted_size(faces):
    body = body_of(faces)
    assert body.watertight
    assert 0.98 * faces <= body.n_faces <= faces
    assert [joint.name for joint in articulation_of(body).joints] == ["wing"]
