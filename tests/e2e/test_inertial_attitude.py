"""A pass with a known inertial attitude through the service and the real tracker: what pointing adds to the error.

Both kinds of mount, both hemispheres, with and without a mirror. The images are drawn by a pinhole camera under
astropy's sky; the error in GCRF may exceed that of the relative pose by 0.1 degrees at most.
"""

from collections.abc import AsyncIterator
from datetime import UTC, datetime, timedelta

import cv2
import numpy as np
import pytest
from api_client import PNG, Api, running
from scipy.spatial.transform import Rotation
from sky_pass import DISTANCE, SITES, UP_DEG, affine_rows, image_of, sky_camera

from gpu.mesh import load_mesh
from service.main import create_app
from service.settings import Settings
from service.simulate.satellite import demo_satellite
from service.workers.inline import InlineTransport
from service.workers.tracker import Tracker

pytestmark = pytest.mark.anyio
START = datetime(2026, 11, 20, 3, 4, 5, tzinfo=UTC)
STEP_S, FRAMES = 0.2, 2
SIZE, PIXEL_DEG = (128, 112), 2.5e-3
SHAPE = load_mesh(demo_satellite(), "glb")
SEED = {"seed": 2}
FIRSTS = np.cumsum([0] + [len(part.vertices) for part in SHAPE.parts])
VERTICES = np.vstack([part.vertices for part in SHAPE.parts])
FACES = np.vstack([part.faces + first for part, first in zip(SHAPE.parts, FIRSTS, strict=False)])
LARGE = 45 * DISTANCE * np.tan(np.deg2rad(PIXEL_DEG)) / SHAPE.radius  # so much and the body's radius is 45 pixels
ATTITUDE = Rotation.from_rotvec([0.4, -1.1, 0.8])
RATE = np.array([0.02, -0.01, 0.03])  # rad/s in GCRF


@pytest.fixture(scope="module")
async def api(tmp_path_factory, anyio_backend) -> AsyncIterator[Api]:
    settings = Settings(data_dir=tmp_path_factory.mktemp("data"))
    async with running(create_app(settings, InlineTransport(Tracker))) as api:
        yield api


def png(pixels: np.ndarray) -> bytes:
    return cv2.imencode(".png", pixels)[1].tobytes()


def sky(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(20, 3, SIZE[::-1])


def drawn(corners: np.ndarray, seed: int) -> bytes:
    """The satellite's faces (F, 3, 2), pixels, filled, and a little blurred."""
    light = np.zeros(SIZE[::-1], np.float32)
    for face in corners:
        # Coordinates are those of outer corners, OpenCV's those of centres; eight fractional bits.
        cv2.fillConvexPoly(light, np.round((face - 0.5) * 256).astype(np.int32), 160.0, cv2.LINE_AA, 8)
    light = cv2.GaussianBlur(light, (0, 0), 0.7)
    return png((sky(seed) + light).clip(0, 255).astype(np.uint8))


def angle_deg(a: Rotation, b: Rotation) -> float:
    return float(np.rad2deg((a.inv() * b).magnitude()))


def rotation(document: dict) -> Rotation:
    return Rotation.from_quat([document["orientation"][axis] for axis in "xyzw"])


@pytest.mark.parametrize("site", SITES)
@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("mount", ["equatorial", "altaz"])
async def test_pointing_adds_less_than_a_tenth_of_a_degree(api, site, mount, mirrored):
    latitude, longitude = SITES[site]
    camera = {
        "mount": mount,
        "up_angle_deg": UP_DEG,
        "mirrored": mirrored,
        "pixel_scale_arcsec": PIXEL_DEG * 3600,
        "site_latitude_deg": latitude,
        "site_longitude_deg": longitude,
    }
    model = (await api.model(demo_satellite(), "demo.glb")).json()["model_id"]
    body = {"model_id": model, "camera": camera, "filter": SEED, "light": {"sun": [0.0, 0.0, -1.0]}}
    here = "/v1/sessions/" + (await api.http.post("/v1/sessions", json=body)).json()["session_id"]
    for seed in range(3):
        await api.http.post(f"{here}/background", content=png(sky(100 + seed).astype(np.uint8)), headers=PNG)
    for k in range(FRAMES):
        moment = START + timedelta(seconds=STEP_S * k)
        azimuth, elevation = 140.0 + 0.4 * k, 40.0 + 0.6 * k
        forward, up, centre = sky_camera(mount, site, moment, azimuth, elevation)
        truth = Rotation.from_rotvec(RATE * STEP_S * k) * ATTITUDE
        points = LARGE * truth.apply(VERTICES)
        image = image_of(points, forward, up, mirrored, SIZE, PIXEL_DEG, (0.012, -0.02))
        matrix, _ = affine_rows(VERTICES - VERTICES.mean(axis=0), image)
        pointing = {"az_deg": azimuth, "el_deg": elevation}
        if mount == "equatorial":
            pointing = {"ra_deg": centre.ra.deg, "dec_deg": centre.dec.deg}
        params = {**pointing, "time": moment.isoformat()}
        answer = await api.http.post(f"{here}/frames", content=drawn(image[FACES], k), headers=PNG, params=params)
        assert answer.status_code == 200, answer.text
        best = answer.json()["best"]
        relative = angle_deg(Rotation.from_matrix(matrix), rotation(best))
        inertial = angle_deg(truth, rotation(best["attitude"]))
        assert inertial - relative < 0.1
        assert relative < 15.0  # it was this satellite that was found
