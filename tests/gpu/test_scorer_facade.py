"""What a user of a scorer sees: names, errors, the fallback, and maps that are kept on the device."""

import numpy as np
import pytest
from gpu_cases import SHAPE, a_map, box, mesh_of, sphere, transforms

import gpu.device
import gpu.scorer
from gpu.errors import DeviceError, DeviceLostError, ImageSizeError, ScorerError
from gpu.scorer import open_scorer


@pytest.fixture
def mesh():
    return mesh_of(sphere(6), box(centre=(1, 0, 0)))


@pytest.fixture
def poses(mesh):
    return transforms(np.random.default_rng(1), mesh, 20, 30.0)


@pytest.fixture
def no_device(monkeypatch):
    monkeypatch.setattr(gpu.scorer, "find_devices", lambda: ())
    monkeypatch.setattr(gpu.device, "find_devices", lambda: ())


def test_says_what_it_runs_on(mesh):
    scorer = open_scorer(mesh)
    assert scorer.name.startswith(("opencl:", "numpy:"))
    scorer.close()


def test_without_a_device_the_reference_takes_over_and_says_so(mesh, poses, no_device):
    values = a_map(np.random.default_rng(2))
    with pytest.warns(RuntimeWarning, match="no OpenCL platform"):
        scorer = open_scorer(mesh)
    assert scorer.name == "numpy:reference"
    assert np.allclose(scorer.score(poses, values), open_scorer(mesh, backend="reference").score(poses, values))


def test_without_a_device_outline_is_refused(mesh, no_device):
    with pytest.raises(DeviceError, match="pocl-opencl-icd"):
        open_scorer(mesh, backend="outline")


def test_unknown_backend_is_refused(mesh):
    with pytest.raises(ScorerError, match="paint"):
        open_scorer(mesh, backend="paint")


def test_no_particles(mesh):
    scorer, none = open_scorer(mesh), np.zeros((0, 2, 3, 4), np.float32)
    assert scorer.score(none, a_map(np.random.default_rng(3))).shape == (0,)


def test_wrong_number_of_parts_is_refused(mesh, poses):
    with pytest.raises(ScorerError, match="not \\(N, 2, 3, 4\\)"):
        open_scorer(mesh).score(poses[:, :1], a_map(np.random.default_rng(3)))


def test_a_map_that_is_not_finite_is_refused(mesh, poses):
    values = np.zeros(SHAPE, np.float32)
    values[3, 4] = np.nan
    with pytest.raises(ScorerError, match="not finite"):
        open_scorer(mesh).score(poses, values)


def test_too_large_an_image_is_refused(mesh, poses):
    with pytest.raises(ImageSizeError, match="8191"):
        open_scorer(mesh).score(poses, np.zeros((1, 9000), np.float32))


def test_poses_that_are_no_poses_give_a_number(mesh):
    poses = np.zeros((4, 2, 3, 4), np.float32)
    poses[1], poses[2], poses[3] = np.nan, np.inf, 1e30
    assert np.isfinite(open_scorer(mesh).score(poses, a_map(np.random.default_rng(3)))).all()


def test_a_read_only_map_is_uploaded_once_and_a_writeable_one_every_time(mesh, poses):
    scorer = open_scorer(mesh)
    values = np.array(a_map(np.random.default_rng(4)))
    before = scorer.score(poses, values)
    values *= 2
    assert np.allclose(scorer.score(poses, values), 2 * before)
    values.flags.writeable = False
    kept = scorer.score(poses, values)
    values.flags.writeable = True
    values *= 2
    values.flags.writeable = False
    assert np.array_equal(scorer.score(poses, values), kept)


def test_a_device_that_fails_is_reported_as_lost(mesh, poses, monkeypatch):
    import pyopencl as cl

    scorer = open_scorer(mesh, backend="outline")

    def fail(*_args, **_options):
        raise cl.RuntimeError("clEnqueueNDRangeKernel failed: OUT_OF_RESOURCES")

    monkeypatch.setattr(cl, "enqueue_copy", fail)
    with pytest.raises(DeviceLostError, match="OUT_OF_RESOURCES"):
        scorer.score(poses, a_map(np.random.default_rng(5)))
