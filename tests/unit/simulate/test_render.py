"""The renderer: right triangle in front, right pixels covered, light from where the sun is."""

import numpy as np
import pytest
import trimesh

from gpu.mesh import Mesh, Part
from gpu.zbuffer import rasterise
from service.inference.articulation import Articulation
from service.inference.state import Poses
from service.simulate.render import Light, Renderer


def slow_raster(corners, width, height):
    """One pixel, one triangle at a time: barycentric coordinates of every pixel centre."""
    face, depth = np.full((height, width), -1), np.full((height, width), np.inf)
    for i, (a, b, c) in enumerate(corners):
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        for y in range(height):
            for x in range(width):
                p = np.array([x + 0.5, y + 0.5])
                u = ((b[0] - p[0]) * (c[1] - p[1]) - (b[1] - p[1]) * (c[0] - p[0])) / area
                v = ((c[0] - p[0]) * (a[1] - p[1]) - (c[1] - p[1]) * (a[0] - p[0])) / area
                if u >= 0 and v >= 0 and u + v <= 1:
                    z = u * a[2] + v * b[2] + (1 - u - v) * c[2]
                    if z < depth[y, x]:
                        face[y, x], depth[y, x] = i, z
    return face, depth


def test_raster_equals_its_slow_twin():
    corners = np.random.default_rng(5).uniform(-4, 24, (14, 3, 3))
    face, depth = slow_raster(corners, 21, 17)
    fast = rasterise(corners, 21, 17)
    np.testing.assert_array_equal(fast.face, face)
    np.testing.assert_allclose(fast.depth[face >= 0], depth[face >= 0], atol=1e-6)


def test_nothing_in_view_is_nothing():
    seen = rasterise(np.full((2, 3, 3), -5.0), 4, 4)
    assert (seen.face == -1).all()
    assert np.isinf(seen.depth).all()


def body(shape: trimesh.Trimesh) -> tuple[Mesh, Articulation]:
    radius = float(np.linalg.norm(shape.vertices, axis=1).max())
    part = Part("a", np.asarray(shape.vertices), shape.faces.astype(np.int32))
    return Mesh((part,), (0, 0, 0), (1, 1, 1), radius, True), Articulation(("a",))


def pose(scale: float, quaternion=(1.0, 0, 0, 0), at=(32.0, 32.0)) -> Poses:
    return Poses(np.array([quaternion]), np.array([at]), np.log([scale]), np.zeros((1, 0)))


def test_coverage_of_a_box_is_exact_to_a_ninth_of_a_pixel():
    mesh, articulation = body(trimesh.creation.box((2.0, 1.0, 1.0)))
    renderer = Renderer(mesh, articulation, np.random.default_rng(0))
    coverage = renderer.render(pose(12.0), (64, 64), Light()).coverage
    assert coverage.sum() == pytest.approx(24 * 12, rel=1e-6)
    ys, xs = np.nonzero(coverage)
    assert (xs.min(), xs.max(), ys.min(), ys.max()) == (20, 43, 26, 37)


def test_the_lit_side_of_a_sphere_faces_the_sun():
    mesh, articulation = body(trimesh.creation.icosphere(subdivisions=4))
    renderer = Renderer(mesh, articulation, np.random.default_rng(0))
    for roll, expected in ((0.0, (1, 0)), (90.0, (0, 1)), (180.0, (-1, 0))):
        light = Light(phase_deg=90.0, sun_roll_deg=roll, ambient=0.0)
        radiance = renderer.render(pose(24.0), (64, 64), light).radiance
        y, x = np.mgrid[:64, :64] + 0.5 - 32
        moment = np.array([(radiance * x).sum(), (radiance * y).sum()]) / radiance.sum()
        assert moment @ expected > 8
        assert abs(moment @ expected[::-1]) < 0.5
    full = renderer.render(pose(24.0), (64, 64), Light(phase_deg=0.0)).radiance
    assert full[32, 32] > 2 * full[32, 10]


def test_a_body_throws_a_shadow_on_what_is_behind_it():
    screen = trimesh.creation.box((4, 4, 0.1)).apply_translation((0, 0, 1.5))
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
    mesh, articulation = body(trimesh.util.concatenate([screen, ball]))
    renderer = Renderer(mesh, articulation, np.random.default_rng(0))
    light = Light(phase_deg=45.0, sun_roll_deg=180.0, ambient=0.0, specular=0.0)
    radiance = renderer.render(pose(14.0), (64, 64), light).radiance
    # The sun is at the upper left in depth: the shadow falls 1.45 units to the right of the ball.
    assert radiance[32, int(32 + 1.45 * 14)] == 0
    assert radiance[32, 6] > 0.1
    assert radiance[10, int(32 + 1.45 * 14)] > 0.1
