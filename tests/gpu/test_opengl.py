"""OpenGL silhouettes against the reference, and how they are handed to OpenCL."""

from dataclasses import replace

import moderngl
import numpy as np
import pyopencl as cl
import pytest
from gpu_cases import MESHES, SHAPE, a_map, box, mesh_of, shared_mesh, soup, sphere, transforms

import gpu.opengl
import gpu.opengl_probe
from gpu.atlas import Bounds, atlas_size
from gpu.device import DeviceReport, find_devices
from gpu.errors import DeviceError, DeviceLostError, ImageSizeError
from gpu.interop import GlSharingHandOver, choose_hand_over
from gpu.opengl import OpenGLScorer, agree
from gpu.opengl_probe import OpenGLReport, expected_hand_over, find_opengl, hand_over_between
from gpu.reference import silhouette_mask
from gpu.renderer import open_gl

HAND_OVERS = ("host_shared", "copy")


@pytest.fixture(params=HAND_OVERS)
def open_opengl(request):
    usable = [report for report in find_devices() if report.rejected is None]
    if not usable:
        pytest.skip("no OpenCL device answers")
    try:
        open_gl().release()
    except DeviceError as error:
        pytest.skip(str(error))
    opened = []

    def open_for(mesh):
        opened.append(OpenGLScorer(mesh, usable[0], request.param))
        return opened[-1]

    yield open_for
    for scorer in opened:
        scorer.close()


def edge_band(mask: np.ndarray) -> np.ndarray:
    """Pixels beside the silhouette's edge, on either side."""
    padded = np.pad(mask, 1, mode="edge")
    near = [padded[1 + dy : 1 + dy + mask.shape[0], 1 + dx : 1 + dx + mask.shape[1]] for dy, dx in np.ndindex(3, 3)]
    near = [padded[dy : dy + mask.shape[0], dx : dx + mask.shape[1]] for dy, dx in np.ndindex(3, 3)]
    return np.logical_or.reduce(near) & ~np.logical_and.reduce(near)


def assert_within_the_edge_band(mesh, scorer, poses, values):
    scores = scorer.score(poses, values)
    for score, pose in zip(scores, poses, strict=True):
        mask = silhouette_mask(mesh, pose, values.shape)
        allowed = np.abs(values[edge_band(mask)]).sum() + 1e-4 * np.abs(values[mask]).sum() + 1e-3
        assert abs(score - values[mask].sum(dtype=np.float64)) <= allowed


@pytest.mark.parametrize(
    ("open_opengl", "name"), [(HAND_OVERS[k % 2], name) for k, name in enumerate(MESHES)], indirect=["open_opengl"]
)
def test_real_spacecraft(shared, open_opengl, name):
    mesh = shared_mesh(shared / "data" / "meshes" / f"{name}.glb")
    rng = np.random.default_rng(20)
    assert_within_the_edge_band(
        mesh, open_opengl(mesh), transforms(rng, mesh, 4, 90.0, (200, 200)), a_map(rng, (200, 200))
    )


@pytest.mark.parametrize(("radius_px", "spread_px"), [(1.0, 30.0), (25.0, 0.0), (50.0, 80.0), (2000.0, 100.0)], ids=str)
def test_any_size_and_place(open_opengl, radius_px, spread_px):
    rng = np.random.default_rng(21)
    mesh = mesh_of(sphere(8), box(centre=(1.4, 0, 0)), soup(rng, 6, 8))
    poses = transforms(rng, mesh, 25, radius_px, spread_px=spread_px)
    assert_within_the_edge_band(mesh, open_opengl(mesh), poses, a_map(rng))


def test_neighbours_in_the_atlas_do_not_touch(open_opengl):
    rng = np.random.default_rng(22)
    mesh = mesh_of(sphere(8), box((6, 0.2, 0.2)))
    poses, values = transforms(rng, mesh, 300, 60.0, spread_px=60.0), a_map(rng)
    scorer = open_opengl(mesh)
    alone = np.concatenate([scorer.score(poses[k : k + 1], values) for k in range(20)])
    together = scorer.score(poses, values)[:20]
    # A tile's place in the atlas moves vertices by rounding: by less than a pixel's worth of the map here and there.
    assert np.abs(alone - together).max() < 5 * np.abs(values).max()


def test_two_scorers_in_one_thread_keep_to_their_own_contexts(open_opengl):
    rng = np.random.default_rng(26)
    values, meshes = a_map(rng), [mesh_of(box()), mesh_of(sphere(), box((6, 0.2, 0.2)))]
    scorers = [open_opengl(mesh) for mesh in meshes]
    for _ in range(2):
        for mesh, scorer in zip(meshes, scorers, strict=True):
            assert_within_the_edge_band(mesh, scorer, transforms(rng, mesh, 5, 30.0), values)
    scorers[1].close()
    assert_within_the_edge_band(meshes[0], scorers[0], transforms(rng, meshes[0], 5, 30.0), values)


def test_more_particles_than_the_atlas_holds(open_opengl):
    rng = np.random.default_rng(23)
    mesh = mesh_of(box())
    shape = (700, 700)
    poses, values = transforms(rng, mesh, 60, 400.0, shape), np.ones(shape, np.float32)
    assert_within_the_edge_band(mesh, open_opengl(mesh), poses, values)


def test_no_particles_and_poses_that_are_no_poses(open_opengl):
    mesh = mesh_of(box())
    scorer = open_opengl(mesh)
    assert scorer.score(np.zeros((0, 1, 3, 4), np.float32), np.ones(SHAPE, np.float32)).shape == (0,)
    poses = np.zeros((2, 1, 3, 4), np.float32)
    poses[1] = np.nan
    assert scorer.score(poses, np.ones(SHAPE, np.float32)).tolist() == [0, 0]


def test_opengl_that_fails_is_reported_as_lost(open_opengl, monkeypatch):
    mesh = mesh_of(box())
    scorer = open_opengl(mesh)

    def fail(*_arguments, **_options):
        raise moderngl.Error("out of memory")

    monkeypatch.setattr(moderngl.Context, "texture", fail)
    with pytest.raises(DeviceLostError, match=r"opengl:.* failed: out of memory"):
        scorer.score(transforms(np.random.default_rng(0), mesh, 2, 20.0), np.ones(SHAPE, np.float32))


def test_an_image_larger_than_a_texture_is_refused(open_opengl):
    scorer = open_opengl(mesh_of(box()))
    with pytest.raises(ImageSizeError):
        scorer.score(np.zeros((1, 1, 3, 4), np.float32), np.zeros((1, 100_000), np.float32))


@pytest.mark.parametrize(
    ("cl_has_gl", "kind", "extensions", "storage", "expected", "reason"),
    [
        (True, "gpu", ("cl_khr_gl_sharing",), True, "gl_sharing", "lists cl_khr_gl_sharing"),
        (True, "cpu", (), True, "host_shared", "does not list cl_khr_gl_sharing"),
        (False, "cpu", ("cl_khr_gl_sharing",), True, "host_shared", "built without GL sharing"),
        (False, "cpu", (), False, "copy", "no buffer storage"),
        (False, "gpu", ("cl_khr_gl_sharing",), True, "copy", "host's memory"),
    ],
)
def test_the_hand_over_is_decided_not_tried(cl_has_gl, kind, extensions, storage, expected, reason):
    choice = choose_hand_over(cl_has_gl, kind, extensions, storage)
    assert choice.name == expected
    assert reason in choice.reason


@pytest.fixture
def sharing_device(monkeypatch):
    """A usable device that says it shares, and a pyopencl that says it can."""
    usable = [report for report in find_devices() if report.rejected is None]
    if not usable:
        pytest.skip("no OpenCL device answers")
    monkeypatch.setattr(cl, "have_gl", lambda: True)
    return replace(usable[0], extensions=("cl_khr_gl_sharing",))


@pytest.fixture
def gl():
    try:
        context = open_gl()
    except DeviceError as error:
        pytest.skip(str(error))
    yield context
    context.release()


def test_a_device_that_refuses_to_share_gets_copies(gl, sharing_device, monkeypatch):
    plain = gpu.opengl._context

    def refusing(report, hand_over):
        if hand_over == "gl_sharing":
            raise DeviceError(f"{report.name} refuses")
        return plain(report, hand_over)

    monkeypatch.setattr(gpu.opengl, "_context", refusing)
    choice, context = agree(gl, sharing_device, None)
    assert (choice.name, choice.reason) == ("copy", f"{sharing_device.name} refuses")
    assert context.devices
    with pytest.raises(DeviceError, match="refuses"):
        agree(gl, sharing_device, "gl_sharing")


def test_what_is_shared_is_acquired_and_given_back_for_every_batch(sharing_device, monkeypatch):
    """With a stand-in for the driver: what OpenCL acquires is what OpenGL's buffer holds at that moment."""
    lent, log = {}, []

    def acquire(queue, buffers):
        log.append("acquired")
        (scorer,) = lent.values()
        cl.enqueue_copy(queue, buffers[0], np.frombuffer(scorer._lent[1]._pixels.read(), np.uint8))

    plain = gpu.opengl._context
    monkeypatch.setattr(gpu.opengl, "_context", lambda report, hand_over: plain(report, "copy"))
    monkeypatch.setattr(GlSharingHandOver, "__init__", standing_in)
    monkeypatch.setattr(cl, "enqueue_acquire_gl_objects", acquire, raising=False)
    monkeypatch.setattr(cl, "enqueue_release_gl_objects", lambda *_: log.append("released"), raising=False)
    rng = np.random.default_rng(27)
    mesh = mesh_of(sphere(8))
    poses, values = transforms(rng, mesh, 40, 400.0, (700, 700)), a_map(rng, (700, 700))
    try:
        lent["scorer"] = OpenGLScorer(mesh, sharing_device)
    except DeviceError as error:
        pytest.skip(str(error))
    copying = OpenGLScorer(mesh, sharing_device, "copy")
    assert lent["scorer"].hand_over.name == "gl_sharing"
    assert np.array_equal(lent["scorer"].score(poses, values), copying.score(poses, values))
    assert len(log) >= 4
    assert log == ["acquired", "released"] * (len(log) // 2)
    lent["scorer"].close()
    copying.close()


def standing_in(self, queue, gl, size):
    """``GlSharingHandOver.__init__`` with a buffer of OpenCL's own in the place of ``cl.GLBuffer``."""
    self._queue, self._gl = queue, gl
    self._pixels = gl.buffer(reserve=size)
    self._buffer = cl.Buffer(queue.context, cl.mem_flags.READ_ONLY, size)


@pytest.mark.parametrize(
    ("script", "expected", "reason"),
    [
        ("print('[\"soft\", 450, []]')", None, ""),
        ("raise Exception('requested platform is not there')", "none", "requested platform"),
        ("import os; os.kill(os.getpid(), 9)", "none", "by signal 9"),
    ],
)
def test_opengl_is_looked_at_in_a_process_of_its_own(monkeypatch, script, expected, reason):
    monkeypatch.setattr(gpu.opengl_probe, "PROBE", script)
    found = find_opengl.__wrapped__()
    assert reason in (found.rejected or "")
    device = DeviceReport("P", "D", "OpenCL 3", "cpu", None, (0, 0))
    choice = hand_over_between(found, device)
    assert choice.name == (expected or "host_shared")


def test_sharing_is_expected_of_a_device_that_says_so(monkeypatch):
    monkeypatch.setattr(cl, "have_gl", lambda: True)
    gpu_report = DeviceReport("P", "D", "OpenCL 3", "gpu", None, (0, 0), ("cl_khr_gl_sharing",))
    assert hand_over_between(OpenGLReport("R", 460), gpu_report).name == "gl_sharing"
    assert hand_over_between(OpenGLReport("R", 460), replace(gpu_report, extensions=())).name == "copy"


def test_without_a_device_nothing_is_handed_over(monkeypatch):
    monkeypatch.setattr(gpu.opengl_probe, "find_devices", lambda: ())
    assert expected_hand_over().name == "none"


def test_tiles_hold_what_they_show():
    mesh = mesh_of(sphere(6))
    rng = np.random.default_rng(24)
    poses = transforms(rng, mesh, 30, 15.0, spread_px=3.0)
    tiles = Bounds(mesh).tiles(poses, SHAPE)
    assert not tiles.clipped
    assert tiles.width % 16 == 0
    assert tiles.width < SHAPE[1] / 2
    for pose, (x, y) in zip(poses, tiles.origins, strict=True):
        mask = silhouette_mask(mesh, pose, SHAPE)
        mask[y : y + tiles.height, x : x + tiles.width] = False
        assert not mask.any()
    width, height = atlas_size(tiles, 30, 16384)
    assert tiles.capacity((width, height)) >= 30


def test_a_tile_larger_than_the_usual_atlas_gets_an_atlas_of_its_own():
    mesh = mesh_of(sphere(6))
    poses = transforms(np.random.default_rng(25), mesh, 2, 9000.0, (5000, 6000))
    tiles = Bounds(mesh).tiles(poses, (5000, 6000))
    assert tiles.clipped
    assert tiles.capacity(atlas_size(tiles, 2, 16384)) >= 1
