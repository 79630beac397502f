"""Where the light comes from: told with the session or the frame, computed, or said to be unknown; never guessed."""

from datetime import UTC, datetime

import numpy as np
import pytest
from api_client import running
from fake_worker import Recorder

from service.api.schemas import Estimate, Light
from service.attitude.sun import sun_from_earth
from service.inference.pose import rotation_matrices

pytestmark = pytest.mark.anyio
TLE = (
    "1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991\n"
    "2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482"
)
SITE = {"site_latitude_deg": 48.23, "site_longitude_deg": 16.34}
LIT, DARK = "2019-12-11T15:05:00Z", "2019-12-11T15:20:00Z"
WHEN = "2026-11-20T03:04:05Z"
POINTED = {"ra_deg": 200, "dec_deg": -35, "position_angle_deg": 30}
UNKNOWN = {"sun": None, "source": "unknown", "sigma_deg": None, "phase_deg": None, "sunlit": None}


@pytest.fixture
async def api(make_app, anyio_backend):
    async with running(make_app(Recorder)) as client:
        yield client


async def light(api, session_id: str, n: int = 0, **query) -> dict:
    return (await api.estimate(session_id, n, **query))["light"]


async def test_a_told_direction_is_stored_as_given_and_used_at_length_one(api):
    session_id = await api.ready_session(light={"sun": [0, 3, -4], "sun_sigma_deg": 2.5})
    session = (await api.http.get(f"/v1/sessions/{session_id}")).json()
    assert session["light"] == {"sun": [0, 3, -4], "sun_sigma_deg": 2.5}
    told = await light(api, session_id)
    assert told["sun"] == pytest.approx({"x": 0, "y": 0.6, "z": -0.8})
    assert (told["source"], told["sunlit"]) == ("told", None)
    assert told["sigma_deg"] == pytest.approx(2.5)
    assert told["phase_deg"] == pytest.approx(np.rad2deg(np.arccos(0.8)))
    job = Recorder.jobs[-1].light
    assert job.towards_sun == pytest.approx((0, 0.6, -0.8)) and job.sigma_rad == pytest.approx(np.deg2rad(2.5))
    assert (job.sunlit, job.earth, job.earthshine, job.mirrored) == (None, None, None, False)


async def test_a_frames_own_goes_before_every_session(api):
    for sections in ({}, {"light": {"sun": "unknown"}}, {"light": {"sun": [0, 0, 1]}}):
        session_id = await api.ready_session(**sections)
        told = await light(api, session_id, sun="2,0,0")
        assert (told["sun"], told["source"], told["sigma_deg"]) == ({"x": 1, "y": 0, "z": 0}, "told", 1.0)
        put = (await api.put(session_id, 1, 1, sun=" -1e-300, 0,0")).json()["light"]
        assert put["sun"]["x"] == -1


async def test_unknown_stays_unknown_and_nothing_is_guessed(api):
    full = {"time": WHEN, **POINTED}
    assert await light(api, await api.ready_session(light={"sun": "unknown"}), **full) == UNKNOWN
    assert await light(api, await api.ready_session(), time=WHEN) == UNKNOWN  # no orientation
    assert await light(api, await api.ready_session(), **POINTED) == UNKNOWN  # no time
    assert Recorder.jobs[-1].light.towards_sun is None and Recorder.jobs[-1].light.sigma_rad is None


@pytest.mark.parametrize("mirrored", [False, True])
async def test_auto_is_the_ephemeris_in_the_cameras_axes(api, mirrored):
    session_id = await api.ready_session(camera={"mirrored": mirrored})
    answer = (await api.post(session_id, 0, time=WHEN, **POINTED)).json()
    found, camera = answer["light"], answer["camera"]["orientation"]
    axes = rotation_matrices(np.array([camera[name] for name in "wxyz"]))
    away = -1 if mirrored else 1  # camera axes of a mirrored image count z towards the observer
    in_gcrf = axes @ (found["sun"]["x"], found["sun"]["y"], away * found["sun"]["z"])
    expected = sun_from_earth(datetime(2026, 11, 20, 3, 4, 5, tzinfo=UTC))
    np.testing.assert_allclose(in_gcrf, expected / np.linalg.norm(expected), atol=1e-12)
    assert (found["source"], found["sigma_deg"], found["sunlit"]) == ("ephemeris", 1.0, None)
    assert found["phase_deg"] == pytest.approx(np.rad2deg(np.arccos(-found["sun"]["z"])))
    assert Recorder.jobs[-1].light.mirrored is mirrored


async def test_an_orbit_tells_shadow_and_earthshine(api):
    session_id = await api.ready_session(camera=SITE, prior={"orbit": TLE})
    lit = await light(api, session_id, time=LIT, **POINTED)
    job = Recorder.jobs[-1].light
    assert lit["sunlit"] is True and job.sunlit == 1.0
    assert np.linalg.norm(job.earth) == pytest.approx(1) and 0 < job.earthshine < 0.2
    dark = await light(api, session_id, 1, time=DARK)  # the camera's orientation is not known here
    assert (dark["sun"], dark["source"], dark["sunlit"]) == (None, "unknown", False)
    assert Recorder.jobs[-1].light.sunlit == 0.0 and Recorder.jobs[-1].light.earth is None
    told = await light(api, session_id, 2, time=DARK, sun="1,0,0")
    assert (told["source"], told["sunlit"]) == ("told", False)


@pytest.mark.parametrize(
    ("section", "field"),
    [
        ({"sun": [0, 0, 0]}, "light.sun"),
        ({"sun": [1, 2]}, "light.sun"),
        ({"sun": [1, 2, 3, 4]}, "light.sun"),
        ({"sun": [1, "a", 0]}, "light.sun"),
        ({"sun": [1, None, 0]}, "light.sun"),
        ({"sun": "north"}, "light.sun"),
        ({"sun": None}, "light.sun"),
        ({"sun_sigma_deg": 0}, "light.sun_sigma_deg"),
        ({"sun_sigma_deg": 181}, "light.sun_sigma_deg"),
        ({"moon": 1}, "light.moon"),
    ],
    ids=str,
)
async def test_what_is_no_direction_is_refused_with_the_session(api, section, field):
    model_id = (await api.model()).json()["model_id"]
    answer = await api.http.post("/v1/sessions", json={"model_id": model_id, "light": section})
    assert (answer.status_code, answer.json()["type"]) == (422, "urn:skypose:problem:invalid-configuration")
    assert answer.json()["field"] == field


@pytest.mark.parametrize("number", ["NaN", "Infinity", "1e999"])
async def test_a_session_takes_finite_numbers_only(api, number):
    model_id = (await api.model()).json()["model_id"]
    text = f'{{"model_id": "{model_id}", "light": {{"sun": [1, {number}, 0]}}}}'
    answer = await api.http.post("/v1/sessions", content=text, headers={"Content-Type": "application/json"})
    assert answer.status_code == 422, answer.text


@pytest.mark.parametrize("text", ["", "1,2", "1,2,3,4", "0,0,0", "nan,0,1", "1,inf,0", "1e999,0,0", "a,b,c", "auto"])
async def test_what_is_no_direction_is_refused_with_the_frame(api, text):
    session_id = await api.ready_session()
    for answer in (await api.post(session_id, 0, sun=text), await api.put(session_id, 0, 0, sun=text)):
        assert (answer.status_code, answer.json()["field"]) == (422, "query:sun")
    assert (await api.http.get(f"/v1/sessions/{session_id}")).json()["frames"] == 0


async def test_a_time_without_an_ephemeris_is_refused(api):
    session_id = await api.ready_session()
    refused = await api.post(session_id, 0, time="1850-01-01T00:00:00Z", **POINTED)
    assert (refused.status_code, refused.json()["field"]) == (422, "query:time")
    assert (await light(api, session_id, time="1850-01-01T00:00:00Z"))["source"] == "unknown"


async def test_a_told_scale_bounds_the_search(api):
    prior = {"scale_px": 12.0, "scale_sigma": 0.05, "mesh_error": 0.03}
    session_id = await api.ready_session(camera={**SITE, "pixel_scale_arcsec": 0.5}, prior=prior)
    await light(api, session_id)
    assert Recorder.jobs[-1].scale_px == pytest.approx((12 * np.exp(-0.15), 12 * np.exp(0.15)))
    both = {"orbit": TLE, "unit_m": 2.0, **prior}  # what is told goes before what is computed
    session_id = await api.ready_session(camera={**SITE, "pixel_scale_arcsec": 0.5}, prior=both)
    await light(api, session_id, time=LIT)
    assert Recorder.jobs[-1].scale_px == pytest.approx((12 * np.exp(-0.15), 12 * np.exp(0.15)))
    model_id = (await api.model()).json()["model_id"]
    scales = {"scale_px": 0}, {"scale_px": -3}, {"scale_px": 1e9}, {"scale_sigma": 0}, {"scale_sigma": 3}
    for bad in (*scales, {"mesh_error": -0.01}, {"mesh_error": 1}):
        answer = await api.http.post("/v1/sessions", json={"model_id": model_id, "prior": bad})
        assert answer.status_code == 422, bad


async def test_a_restart_and_another_server_keep_it(make_app):
    app = make_app(Recorder)
    async with running(app) as api:
        session_id = await api.ready_session(light={"sun": [0, 0, -2]})
        first = await light(api, session_id, sun="0,2,0")
    async with running(make_app(Recorder)) as api:
        stored = (await api.http.get(f"/v1/sessions/{session_id}/estimates/0")).json()
        assert stored["light"] == first
        assert (await light(api, session_id, 1))["sun"] == {"x": 0, "y": 0, "z": -1}
        blob = (await api.http.get(f"/v1/sessions/{session_id}/checkpoint")).content
        answer = await api.http.put("/v1/sessions/elsewhere/checkpoint", content=blob)
        assert answer.status_code == 201, answer.text
        assert answer.json()["light"] == {"sun": [0, 0, -2], "sun_sigma_deg": 1.0}
        assert (await light(api, "elsewhere", 2))["sun"] == {"x": 0, "y": 0, "z": -1}


async def test_an_estimate_from_before_reads_as_unknown(api):
    session_id = await api.ready_session()
    old = (await api.post(session_id, 0)).json()
    del old["light"]
    assert Estimate.model_validate(old).light == Light(**UNKNOWN)
