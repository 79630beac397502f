"""A session's pinhole camera: what of it is told where, and silhouettes against OpenCV's own projection."""

from datetime import UTC, datetime

import cv2
import numpy as np
import pytest
from lit_body import lit_mesh

from service.attitude.pointing import Pointing
from service.bench.real import pinhole_mask
from service.bench.silhouette import overlap
from service.errors import ConfigError
from service.inference.model.drawing import Lens
from service.inference.pose import exp_so3, rotation_matrices
from service.inference.state import PoseEstimate
from service.sessions.absolute import attitude_document, mount_of, view_of
from service.sessions.config import effective
from service.workers.full_frame import lens_of
from service.workers.pictures import draw_silhouette

OF_CENTRES = (279.5, 207.5)  # the same where the first pixel's centre is 0, 0, as OpenCV counts
FOCAL, MIDDLE = 600.0, (280.0, 208.0)


def test_a_silhouette_is_where_a_pinhole_camera_sees_the_body():
    mesh, articulation = lit_mesh()
    for seed in range(5):
        rng = np.random.default_rng(seed)
        quaternion = exp_so3(rng.normal(size=(1, 3)))[0]
        place = np.array([rng.uniform(-2, 2), rng.uniform(-1, 1), rng.uniform(3.0, 6.0) * mesh.radius])
        matrix = np.eye(4)
        matrix[:3, :3] = rotation_matrices(quaternion)
        matrix[:3, 3] = place - matrix[:3, :3] @ mesh.centre  # of the mesh file's own origin
        seen = pinhole_mask(mesh, matrix, np.array([FOCAL, FOCAL, *OF_CENTRES]), (640, 480))
        position = np.array(MIDDLE) + FOCAL * place[:2] / place[2]
        pose = PoseEstimate(quaternion, position, FOCAL / place[2], np.zeros(1))
        lens = Lens(FOCAL, MIDDLE)
        drawn = draw_silhouette(mesh, articulation, pose, (480, 640), lens)
        assert not (drawn & ~seen).any()  # OpenCV paints what an edge touches too
        inside = cv2.erode(seen.astype(np.uint8), np.ones((5, 5))).astype(bool)
        assert (inside & ~drawn).sum() < 0.01 * inside.sum()  # gaps of a pixel
        assert overlap(draw_silhouette(mesh, articulation, pose, (480, 640)), seen) < 0.93


def test_the_camera_is_told_in_pixels_of_the_window():
    camera = {"perspective": 800.0, "roi": [20, 40, 100, 80], "binning": 2}
    assert lens_of(effective({}).camera, 200, 160) is None
    assert lens_of(effective({"camera": camera}).camera, 200, 160) == Lens(400.0, (40.0, 20.0))
    assert lens_of(effective({"camera": camera}).camera, 200, 160, whole=True) == Lens(800.0, (100.0, 80.0))
    moved = effective({"camera": {**camera, "principal_point": [120.0, 41.0]}}).camera
    assert lens_of(moved, 200, 160) == Lens(400.0, (50.0, 0.5))


@pytest.mark.parametrize(
    ("sections", "said"),
    [
        ({"camera": {"perspective": 0.0}}, "focal length"),
        ({"camera": {"principal_point": [3.0, 4.0]}}, "belongs to a focal length"),
        ({"camera": {"perspective": 500.0}, "filter": {"preset": "paper"}}, "affine"),
    ],
)
def test_what_cannot_be_is_refused(sections, said):
    with pytest.raises(ConfigError, match=said):
        effective(sections)


def test_an_attitude_is_relative_to_the_optical_axis():
    moment = datetime(2026, 5, 1, 3, 0, tzinfo=UTC)
    pointing = Pointing(ra_deg=80.0, dec_deg=10.0, position_angle_deg=0.0)
    camera, told = {"pixel_scale_arcsec": 3600.0}, []
    for more in ({}, {"perspective": 57.0}):
        mount = mount_of(effective({"camera": {**camera, **more}}).camera)
        view = view_of(pointing, mount, moment, time_known=True, size=(40, 40))
        poses = [PoseEstimate(np.array([1.0, 0, 0, 0]), np.array([x, 20.0]), 5.0, np.zeros(0)) for x in (20.0, 40.0)]
        told.append([attitude_document(view, pose, None)["orientation"] for pose in poses])
    assert told[1][0] == told[1][1] == told[0][0] != told[0][1]
