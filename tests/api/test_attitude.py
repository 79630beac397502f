"""Absolute attitude through the service: pointing in, body -> GCRF out, and out again as files of other programs."""

import io
import json

import numpy as np
import pytest
from api_client import running
from brahe.ccsds import AEM, APM
from fake_worker import CUBE, RATE

from service.api.schemas import Estimate
from service.attitude.camera import equatorial_camera
from service.inference.pose import rotation_matrices

pytestmark = pytest.mark.anyio

SITE = {"site_latitude_deg": -30.24, "site_longitude_deg": -70.74}
EQUATORIAL = {"up_angle_deg": 20.0}


def quaternion(document: dict) -> np.ndarray:
    return np.array([document["orientation"][axis] for axis in "wxyz"])


async def tracked(api, camera: dict, queries: list[dict]) -> str:
    session_id = await api.ready_session(CUBE + b"joint", camera=camera, name="TOPEX")
    for n, query in enumerate(queries):
        answer = await api.post(session_id, n, time=f"2026-11-20T03:04:{n:02d}Z", **query)
        assert answer.status_code == 200, answer.text
        Estimate.model_validate(answer.json())
    return session_id


async def latest(api, session_id: str) -> dict:
    return (await api.http.get(f"/v1/sessions/{session_id}/estimates/latest")).json()


@pytest.mark.parametrize("mirrored", [False, True])
async def test_attitude_is_the_camera_times_the_pose(api, mirrored):
    camera = {**EQUATORIAL, "mirrored": mirrored}
    estimate = await latest(api, await tracked(api, camera, [{"ra_deg": 200, "dec_deg": -35}]))
    axes = equatorial_camera(200, -35, 20, mirrored=mirrored)
    for pose in (estimate["mean"], estimate["best"], estimate["modes"][0]["pose"]):
        expected = axes @ rotation_matrices(quaternion(pose))
        found = rotation_matrices(quaternion(pose["attitude"]))
        np.testing.assert_allclose(found, expected, atol=1e-12)
    body, gcrf = (np.array(estimate["mean"]["attitude"][f"covariance_{axes}_deg2"]) for axes in ("body", "gcrf"))
    np.testing.assert_allclose(np.linalg.eigvalsh(body), np.linalg.eigvalsh(gcrf))
    assert estimate["camera"]["mirrored"] is mirrored
    np.testing.assert_allclose(rotation_matrices(quaternion(estimate["camera"])), axes, atol=1e-12)


async def test_a_position_angle_of_the_frame_wins_and_without_any_there_is_no_attitude(api):
    place = {"ra_deg": 10, "dec_deg": 80}
    turned = await latest(api, await tracked(api, EQUATORIAL, [{**place, "position_angle_deg": -50}]))
    np.testing.assert_allclose(
        rotation_matrices(quaternion(turned["camera"])), equatorial_camera(10, 80, -50), atol=1e-12
    )
    unknown = await latest(api, await tracked(api, {}, [place]))
    assert unknown["camera"] is None and unknown["mean"]["attitude"] is None


async def test_azimuth_and_elevation(api):
    camera = {"mount": "altaz", "up_angle_deg": 0.0, **SITE}
    session_id = await tracked(api, camera, [{"az_deg": 120, "el_deg": 45}])
    earth = (await latest(api, session_id))["camera"]["earth_orientation"]
    assert earth["known"] and abs(earth["ut1_utc_s"]) < 0.9
    for query, field in (
        ({"az_deg": 120}, "query:el_deg"),
        ({"az_deg": 120, "el_deg": 45, "time": None}, "query:time"),
    ):
        params = {"time": "2026-11-20T03:05:00Z", **query}
        refused = await api.post(session_id, 5, **{key: value for key, value in params.items() if value is not None})
        assert (refused.status_code, refused.json()["field"]) == (422, field)
    nowhere = await api.ready_session(camera=EQUATORIAL)
    refused = await api.post(nowhere, 1, az_deg=1, el_deg=2, time="2026-11-20T03:05:00Z")
    assert (refused.status_code, refused.json()["field"]) == (422, "query:az_deg")
    model_id = (await api.http.get(f"/v1/sessions/{nowhere}")).json()["model_id"]
    answer = await api.http.post("/v1/sessions", json={"model_id": model_id, "camera": {"mount": "altaz"}})
    assert answer.status_code == 422


async def test_a_pixel_scale_counts_where_the_object_stands_in_the_image(api):
    place = {"ra_deg": 0, "dec_deg": 0, "position_angle_deg": 0}
    estimate = await latest(api, await tracked(api, {"pixel_scale_arcsec": 360.0}, [place]))
    best = estimate["best"]
    plain = equatorial_camera(0, 0, 0) @ rotation_matrices(quaternion(best))
    turn = rotation_matrices(quaternion(best["attitude"])) @ plain.T
    angle_deg = np.rad2deg(np.arccos((np.trace(turn) - 1) / 2))
    offset_px = np.hypot(best["x_px"] - 8, best["y_px"] - 8)  # the images have 16 x 16 pixels
    assert angle_deg == pytest.approx(0.1 * offset_px, rel=1e-3)


async def test_exports_hold_the_attitudes(api):
    queries = [{"ra_deg": 100 + n, "dec_deg": 20} for n in range(4)]
    session_id = await tracked(api, EQUATORIAL, queries)
    here = f"/v1/sessions/{session_id}/export"
    page = (await api.http.get(f"/v1/sessions/{session_id}/estimates")).json()["estimates"]
    expected = [rotation_matrices(quaternion(e["mean"]["attitude"])) for e in page]

    async def export(form: str) -> bytes:
        answer = await api.http.get(here, params={"format": form, "pose": "mean", "object_id": "1992-052A"})
        assert answer.status_code == 200, answer.text
        return answer.content

    first, rest = AEM.from_str((await export("aem")).decode()).segments  # the first frame's rate is not known
    assert (first.object_name, first.object_id) == ("TOPEX", "1992-052A")
    for state, matrix in zip([*first.states, *rest.states], expected, strict=True):
        np.testing.assert_allclose(state.quaternion.to_rotation_matrix().to_matrix(), matrix.T, atol=1e-9)
    apm = APM.from_str((await export("apm")).decode()).quaternion_states[0].quaternion
    np.testing.assert_allclose(apm.to_rotation_matrix().to_matrix(), expected[-1].T, atol=1e-9)
    arrays = np.load(io.BytesIO(await export("npz")))
    np.testing.assert_allclose(rotation_matrices(arrays["attitude_gcrf"]), expected, atol=1e-12)
    assert (await export("stk")).decode().count("\n2.000000 ") == 1
    assert json.loads(await export("czml"))[1]["id"] == "1992-052A"
    drawn = json.loads((await api.http.get(here, params={"format": "czml", "model": True})).content)[1]["model"]
    assert drawn["gltf"].startswith("data:model/gltf-binary") and drawn["scale"] == 1.0


async def test_a_restart_changes_no_attitude(make_app):
    queries = [{"ra_deg": 100 + 2 * n, "dec_deg": 20 + n} for n in range(3)]
    documents = []
    for stop in (False, True):
        app = make_app()
        async with running(app) as api:
            session_id = await tracked(api, EQUATORIAL, queries[:2])
            if stop:
                owner = await app.state.services.registry.get(session_id)
                await owner.inbox.close()
            answer = await api.post(session_id, 2, time="2026-11-20T03:04:02Z", **queries[2])
            documents.append(answer.json()["mean"]["attitude"])
    assert documents[0] == documents[1]
    assert "angular_velocity_body_deg_s" in documents[0]


async def test_angular_velocity_is_the_bodys_and_the_cameras(api):
    """A camera that rolls at 3 degrees a second: the rate along its axis is added in body axes."""
    queries = [{"ra_deg": 50, "dec_deg": -20, "position_angle_deg": 3.0 * n} for n in range(2)]
    session_id = await tracked(api, {}, queries)
    first = (await api.http.get(f"/v1/sessions/{session_id}/estimates/0")).json()
    assert "angular_velocity_body_deg_s" not in first["mean"]["attitude"]  # no frame before: the camera's is unknown
    mean = (await latest(api, session_id))["mean"]
    # Position angle grows anticlockwise on the sky: about the axis away from the camera, against the right hand.
    camera_rate = rotation_matrices(quaternion(mean)).T @ [0, 0, -3.0]
    found = mean["attitude"]
    np.testing.assert_allclose(found["angular_velocity_body_deg_s"], np.rad2deg(RATE) + camera_rate, atol=1e-9)
    turned = rotation_matrices(quaternion(found)) @ found["angular_velocity_body_deg_s"]
    np.testing.assert_allclose(turned, found["angular_velocity_gcrf_deg_s"])
