"""Bodies drawn and lit on the device, against NumPy."""

import numpy as np
import pytest

from gpu.errors import DeviceLostError
from gpu.mesh import Mesh, assemble, load_mesh
from gpu.raw_part import RawPart
from gpu.sunlit import Sunlit, open_sunlit
from service.imaging.shading import Patch
from service.inference.articulation import part_transforms
from service.inference.pose import exp_so3
from service.inference.state import Poses
from service.models.articulations import read_joints
from service.simulate.satellite import demo_satellite
from service.workers.sunlit import FIT, SunlitBody


def soup(n_faces: int) -> Mesh:
    """Triangles anywhere, through each other."""
    rng = np.random.default_rng(n_faces)
    centres = rng.uniform(-1, 1, (n_faces, 1, 3))
    vertices = (centres + rng.uniform(-0.5, 0.5, (n_faces, 3, 3))).reshape(-1, 3)
    return assemble([RawPart("soup", vertices, np.arange(3 * n_faces).reshape(-1, 3))])


def views(mesh: Mesh, count: int, radius_px: float, side: int) -> np.ndarray:
    """(N, P, 3, 4): turned at random, some of them half out of the patch."""
    rng = np.random.default_rng(count)
    n_parts = len(mesh.parts)
    poses = Poses(
        exp_so3(rng.standard_normal((count, 3)) * 2),
        rng.uniform(0.2, 0.8, (count, 2)) * side,
        np.log(np.full(count, radius_px / mesh.radius)),
        np.zeros((count, 0)),
    )
    if n_parts == 1:
        data = demo_satellite()
        whole = read_joints(data, "glb", load_mesh(data, "glb")).articulation
        return part_transforms(type(whole)(("soup",), ()), poses)
    data = demo_satellite()
    articulation = read_joints(data, "glb", mesh).articulation
    joints = np.tile([joint.initial for joint in articulation.joints], (count, 1))
    return part_transforms(articulation, Poses(poses.quaternion, poses.position, poses.log_scale, joints))


BODIES = [pytest.param(load_mesh(demo_satellite(), "glb"), id="demo"), pytest.param(soup(7), id="7 triangles")]
BODIES.append(pytest.param(soup(300), id="300 triangles"))


def patch_of(side: int, blur_px: float, zoom: float = 1.0) -> Patch:
    """A bright disc with noise."""
    rng = np.random.default_rng(side)
    y, x = np.mgrid[:side, :side] - side / 2
    disc = np.hypot(x, y) < side / 3
    brightness = 20 * disc * np.clip(1 + x / side, 0, None) + rng.standard_normal((side, side))
    return Patch(brightness.astype(np.float32), disc, np.array([3.0, -2.0]), zoom, blur_px)


@pytest.mark.parametrize("mesh", BODIES)
@pytest.mark.parametrize("side", [9, 40, 64])
def test_every_pixel_sees_the_face_that_numpy_says(mesh, side):
    patch = patch_of(side, 0.6, zoom=0.8)
    device, plain = SunlitBody(mesh, open_sunlit(mesh, FIT)), SunlitBody(mesh)
    covered = 0
    for one in views(mesh, 12, 0.4 * side, side):
        ours, wanted = device.draw(one, patch), plain.draw(one, patch)
        other = np.count_nonzero(ours.face != wanted.face)
        assert other <= 0.01 * side * side  # where faces meet, to the rounding
        same = (ours.face == wanted.face) & (wanted.face >= 0)
        covered += np.count_nonzero(same)
        assert ours.depth[same] == pytest.approx(wanted.depth[same], abs=1e-3 * side)
    assert covered > side
    device.close()


@pytest.mark.parametrize("mesh", BODIES)
@pytest.mark.parametrize(("side", "blur_px"), [(9, 0.5), (40, 1.0), (64, 1.7), (33, 6.0)])
def test_light_explains_as_much_as_numpy_says(mesh, side, blur_px):
    """Blurs wider than the patch too. Which of two lights is better may turn on the rounding: a median, and a bound."""
    patch = patch_of(side, blur_px)
    device, plain = SunlitBody(mesh, open_sunlit(mesh, FIT)), SunlitBody(mesh)
    transforms = views(mesh, 30, 0.35 * side, side)
    ours, wanted = device.explained(transforms, patch), plain.explained(transforms, patch)
    assert np.ptp(wanted) > 0.05
    assert np.median(np.abs(ours - wanted)) < 1e-4
    assert np.abs(ours - wanted).max() < 0.03
    device.close()


def test_many_are_answered_as_one_by_one():
    mesh, patch = soup(50), patch_of(48, 0.8)
    device = SunlitBody(mesh, open_sunlit(mesh, FIT))
    transforms = views(mesh, 20, 18.0, 48)
    assert np.array_equal(
        device.explained(transforms, patch), np.concatenate([device.explained(one[None], patch) for one in transforms])
    )
    device.close()


def test_a_frame_without_light_or_body_explains_nothing():
    mesh = soup(5)
    dark = Patch(np.zeros((16, 16), np.float32), np.zeros((16, 16), bool), np.zeros(2), 1.0, 0.7)
    device = SunlitBody(mesh, open_sunlit(mesh, FIT))
    away = views(mesh, 3, 4.0, 16)
    away[:, :, :2, 3] += 500.0
    assert np.array_equal(device.explained(away, dark), np.zeros(3))
    assert np.array_equal(SunlitBody(mesh).explained(away, dark), np.zeros(3))
    device.close()


def test_without_its_device_it_goes_on_by_numpy():
    class Lost(Sunlit):
        def __init__(self) -> None:
            pass

        def left_over(self, *_: object) -> np.ndarray:
            raise DeviceLostError("gone")

        def draw(self, *_: object) -> list:
            raise DeviceLostError("gone")

    mesh, patch = soup(20), patch_of(32, 0.7)
    transforms = views(mesh, 4, 12.0, 32)
    for question in ("explained", "draw"):
        ask = transforms if question == "explained" else transforms[0]
        body = SunlitBody(mesh, Lost())
        with pytest.warns(RuntimeWarning, match="by NumPy"):
            answer = getattr(body, question)(ask, patch)
        wanted = getattr(SunlitBody(mesh), question)(ask, patch)
        answer, wanted = (getattr(one, "face", one) for one in (answer, wanted))
        assert np.array_equal(answer, wanted)
