"""Poses held against a simulated frame's light and shade."""

import numpy as np
import pytest

from gpu.mesh import load_mesh
from gpu.zbuffer import drawable, rasterise
from service.imaging.measurement import FrameMaps
from service.inference.pose import exp_so3, multiply
from service.inference.state import Poses
from service.models.articulations import read_joints
from service.simulate.render import Light, Renderer
from service.simulate.satellite import demo_satellite
from service.workers.shading import Shading

SIZE = (128, 128)


@pytest.fixture(scope="module")
def demo():
    data = demo_satellite()
    mesh = load_mesh(data, "glb")
    return mesh, read_joints(data, "glb", mesh).articulation


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
    mesh, articulation = demo
    true = pose(mesh, np.array([[joint.initial for joint in articulation.joints]]))
    shade = Shading(mesh, articulation, maps_of(mesh, articulation, true, Light(phase_deg=70, sun_roll_deg=roll_deg)))
    rng = np.random.default_rng(3)
    axes = rng.standard_normal((12, 3))
    turns = exp_so3(np.deg2rad(60) * axes / np.linalg.norm(axes, axis=1, keepdims=True))
    others = Poses(
        multiply(np.repeat(true.quaternion, 12, axis=0), turns),
        *(np.repeat(field, 12, axis=0) for field in (true.position, true.log_scale, true.joints)),
    )
    assert shade(true)[0] > shade(others).max() + 0.2


def test_without_brightness_shading_says_nothing(demo):
    mesh, articulation = demo
    true = pose(mesh, np.array([[joint.initial for joint in articulation.joints]]))
    shade = Shading(mesh, articulation, FrameMaps(np.zeros((128, 128), np.float32), 0.0, None))
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
