"""Poses held against a simulated frame's light and shade."""

import numpy as np
import pytest

from gpu.mesh import load_mesh
from gpu.sunlit import open_sunlit
from gpu.zbuffer import drawable, rasterise
from service.imaging.lighting import View
from service.imaging.measurement import FrameMaps
from service.inference.pose import angle_between, exp_so3, multiply, retract
from service.inference.state import Poses
from service.models.articulations import read_joints
from service.simulate.render import Light, Renderer
from service.simulate.satellite import demo_satellite
from service.workers.shading import Shading
from service.workers.sunlit import FIT, SunlitBody

SIZE = (128, 128)


@pytest.fixture(scope="module", params=["by NumPy", "on the device"])
def demo(request):
    data = demo_satellite()
    mesh = load_mesh(data, "glb")
    on_device = request.param == "on the device"
    body = SunlitBody(mesh, open_sunlit(mesh, FIT)) if on_device else SunlitBody(mesh)
    yield body, read_joints(data, "glb", mesh).articulation
    body.close()


def pose(mesh, joints: np.ndarray) -> Poses:
    turned = exp_so3(np.array([[0.5, -0.8, 0.3]]))
    return Poses(turned, np.array([[66.0, 60.0]]), np.log([45.0 / mesh.radius]), joints)


def maps_of(mesh, articulation, poses: Poses, light: Light) -> FrameMaps:
    """What ``measure`` would make of the body's picture: here without a sky and nearly without noise."""
    rng = np.random.default_rng(2)
    picture = Renderer(mesh, articulation, np.random.default_rng(4)).render(poses, SIZE, light)
    brightness = (60.0 * picture.radiance + rng.standard_normal(picture.radiance.shape)).astype(np.float32)
    log_ratio = np.where(brightness > 4, 3.0, -0.5).astype(np.float32)
    return FrameMaps(log_ratio, 0.0, 0.5, lambda: brightness)


@pytest.mark.parametrize("roll_deg", [0.0, 100.0, 230.0])
def test_the_true_pose_explains_a_side_lit_frame_best(demo, roll_deg):
    body, articulation = demo
    true = pose(body.mesh, np.array([[joint.initial for joint in articulation.joints]]))
    light = Light(phase_deg=70, sun_roll_deg=roll_deg)
    shade = Shading(body, articulation, maps_of(body.mesh, articulation, true, light))
    rng = np.random.default_rng(3)
    axes = rng.standard_normal((12, 3))
    turns = exp_so3(np.deg2rad(60) * axes / np.linalg.norm(axes, axis=1, keepdims=True))
    others = Poses(
        multiply(np.repeat(true.quaternion, 12, axis=0), turns),
        *(np.repeat(field, 12, axis=0) for field in (true.position, true.log_scale, true.joints)),
    )
    assert shade(true)[0] > shade(others).max() + 0.2


def test_without_brightness_shading_says_nothing(demo):
    body, articulation = demo
    true = pose(body.mesh, np.array([[joint.initial for joint in articulation.joints]]))
    shade = Shading(body, articulation, FrameMaps(np.zeros((128, 128), np.float32), 0.0, None))
    assert shade(true) == pytest.approx([0.0])


def test_faces_left_out_beforehand_cover_no_pixel():
    rng = np.random.default_rng(5)
    vertices = np.column_stack([rng.uniform(-4, 20, (900, 2)), rng.uniform(0, 9, 900)])
    vertices[300:] = vertices[:300].repeat(2, axis=0) + 0.4 * rng.standard_normal((600, 3))  # small triangles too
    faces = np.column_stack([np.arange(300), 300 + 2 * np.arange(300), 301 + 2 * np.arange(300)]).astype(np.int32)
    faces = np.vstack([faces, rng.integers(0, 900, (20, 3), dtype=np.int32)])
    chosen = drawable(vertices, faces, 16, 12)
    assert 0 < len(chosen) < len(faces)
    everything = rasterise(vertices[faces], 16, 12)
    some = rasterise(vertices[faces[chosen]], 16, 12)
    assert np.array_equal(np.where(some.face >= 0, chosen[some.face], -1), everything.face)


def steps_back(shade: Shading, away: Poses, rounds: int = 4) -> Poses:
    """Gauss-Newton steps by brightness alone."""
    for _ in range(rounds):
        found = shade.near(away)
        assert found is not None
        known = np.linalg.pinv(found.curvature, rcond=1e-4, hermitian=True)
        away = retract(away, (known @ found.gradient)[None])
    return away


def test_steps_by_brightness_alone_lead_back_to_the_true_pose(demo):
    body, articulation = demo
    true = pose(body.mesh, np.array([[joint.initial for joint in articulation.joints]]))
    shade = Shading(body, articulation, maps_of(body.mesh, articulation, true, Light(phase_deg=50, sun_roll_deg=70)))
    before, after = [], []
    for seed in range(8):
        offset = np.random.default_rng(seed).standard_normal((1, true.joints.shape[1] + 6))
        offset *= np.array([0.03, 0.03, 0.03, 0.6, 0.6, 0.01, *np.full(true.joints.shape[1], 2.0)])
        away = retract(true, offset)
        back = steps_back(shade, away)
        before.append(np.rad2deg(angle_between(away.quaternion, true.quaternion))[0])
        after.append(np.rad2deg(angle_between(back.quaternion, true.quaternion))[0])
        assert np.hypot(*(back.position - true.position)[0]) < 0.5
    assert np.median(after) < 0.5 * np.median(before)
    assert max(after) < 0.5 * max(before)


def test_the_curvature_has_no_negative_direction_and_few_pixels_count(demo):
    """A fourth of the patch's at most: many belong together."""
    body, articulation = demo
    true = pose(body.mesh, np.array([[joint.initial for joint in articulation.joints]]))
    maps = maps_of(body.mesh, articulation, true, Light(phase_deg=50, sun_roll_deg=70))
    found = Shading(body, articulation, maps).near(true)
    assert found is not None
    assert np.linalg.eigvalsh(found.curvature).min() > -1e-6 * np.trace(found.curvature)
    assert found.pixels < 128 * 128 / 4


def test_a_pose_outside_of_the_patch_says_nothing(demo):
    body, articulation = demo
    true = pose(body.mesh, np.array([[joint.initial for joint in articulation.joints]]))
    shade = Shading(body, articulation, maps_of(body.mesh, articulation, true, Light()))
    assert shade.near(Poses(true.quaternion, true.position + 500.0, true.log_scale, true.joints)) is None
    dark = Shading(body, articulation, FrameMaps(np.zeros((128, 128), np.float32), 0.0, None))
    assert dark.near(true) is None


def test_the_view_moves_as_the_drawn_body_does(demo):
    """Flow and turn of the normals, against the body drawn a little further on."""
    body, articulation = demo
    true = pose(body.mesh, np.array([[joint.initial for joint in articulation.joints]]))
    maps = maps_of(body.mesh, articulation, true, Light())
    seen: list[View] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("service.workers.shading.align", lambda _, view: seen.append(view))
        Shading(body, articulation, maps).near(true)
        for k in range(6 + articulation.n_joints):
            small = 1e-3 if k in (0, 1, 2, 5) else 0.05
            Shading(body, articulation, maps).near(retract(true, small * np.eye(6 + articulation.n_joints)[k : k + 1]))
            same = np.isin(seen[0].pixel, seen[-1].pixel)
            moved = seen[-1].normal[np.isin(seen[-1].pixel, seen[0].pixel)] - seen[0].normal[same]
            close = np.abs(moved).max(axis=1) < 0.1  # the same face is seen
            expected = small * seen[0].turn[k][same]
            assert np.median(np.abs(moved - expected)[close]) < 1e-3 + 0.05 * np.abs(expected).max()
    side = 128
    flow = seen[0].flow
    assert flow[3] == pytest.approx(np.broadcast_to(flow[3, :1], flow[3].shape))  # x moves every pixel alike
    assert flow[3, 0, 1] == pytest.approx(0.0)
    assert flow[3, 0, 0] > 0 and seen[0].pixel.max() < side * side
