"""A pass over a real site with a known inertial attitude: astropy's sky, a pinhole camera, and the way back.

The filter's part is done exactly, by the affine pose that fits the points' images best; what is left is the error of
the attitude's own arithmetic, which must stay below 0.1 degrees.
"""

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from sky_pass import SITES, UP_DEG, affine_rows, image_of, sky_camera

from service.imaging.facts import NOTHING
from service.inference.params import CameraParams
from service.inference.pose import exp_so3, from_matrices, log_so3, multiply, rotation_matrices
from service.inference.state import PoseEstimate
from service.sessions.absolute import View, attitude_document, mount_of, pointing_of, rate_since, view_of

START = datetime(2026, 11, 20, 3, 4, 5, tzinfo=UTC)
PIXEL_DEG, SIZE_PX = 2e-4, (1024, 768)
RATE = np.array([0.02, -0.01, 0.03])  # rad/s, fixed in GCRF
STEP_S = 2.0


def attitude(seconds: float) -> np.ndarray:
    return multiply(exp_so3(RATE * seconds), exp_so3(np.array([0.4, -1.1, 0.8])))


def affine_pose(points, image) -> PoseEstimate:
    matrix, scale = affine_rows(points, image)
    return PoseEstimate(from_matrices(matrix), image.mean(axis=0), scale, np.zeros(0))


@pytest.mark.parametrize("site", SITES)
@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("kind", ["equatorial", "altaz", "altaz told in right ascension"])
def test_attitude_and_rate_come_back(site, mirrored, kind):
    latitude, longitude = SITES[site]
    mount = kind.split()[0]
    params = CameraParams(
        mount=mount,
        up_angle_deg=UP_DEG,
        mirrored=mirrored,
        pixel_scale_arcsec=PIXEL_DEG * 3600,
        site_latitude_deg=latitude,
        site_longitude_deg=longitude,
    )
    points = np.random.default_rng(12).normal(size=(40, 3))
    points -= points.mean(axis=0)
    before, quaternions = None, []
    for k in range(5):
        moment = START + timedelta(seconds=STEP_S * k)
        azimuth, elevation = 140.0 + 3.0 * k, 40.0 + 4.0 * k
        forward, up, centre = sky_camera(mount, site, moment, azimuth, elevation)
        truth = attitude(STEP_S * k)
        image = image_of(points @ rotation_matrices(truth).T, forward, up, mirrored, SIZE_PX, PIXEL_DEG)
        pose = affine_pose(points, image)
        query = {"az_deg": azimuth, "el_deg": elevation}
        if kind != "altaz":
            query = {"ra_deg": centre.ra.deg, "dec_deg": centre.dec.deg}
        view = view_of(pointing_of(query, NOTHING), mount_of(params), moment, time_known=True, size=SIZE_PX)
        turn = None if before is None else rate_since(before, view.quaternion, STEP_S)
        quaternions.append(pose.quaternion)
        found = told(view, pose, turn, quaternions)
        error = log_so3(multiply(truth * [1, -1, -1, -1], found["orientation"]))
        assert np.rad2deg(np.linalg.norm(error)) < 0.03
        if turn is not None:
            np.testing.assert_allclose(found["rate"], np.rad2deg(RATE), atol=0.25)
        before = view.quaternion


def told(view, pose, turn, quaternions) -> dict:
    """What the API would tell; the rate against the camera from the last two poses."""
    rate = None
    if turn is not None:
        rate = log_so3(multiply(quaternions[-2] * [1, -1, -1, -1], quaternions[-1])) / STEP_S
    pose = PoseEstimate(pose.quaternion, pose.position, pose.scale, pose.joints, rate)
    document = attitude_document(View(view.camera, view.centre_px, turn), pose, None)
    orientation = np.array([document["orientation"][axis] for axis in "wxyz"])
    return {"orientation": orientation, "rate": document.get("angular_velocity_gcrf_deg_s")}
