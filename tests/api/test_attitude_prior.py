"""`prior.attitude_mode`: asked for, told in every answer that it weighed, never silent."""

import numpy as np
import pytest
from api_client import running
from fake_worker import Recorder

from service.inference.pose import rotation_matrices

pytestmark = pytest.mark.anyio
TLE = (
    "1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991\n"
    "2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482"
)
SITE = {"site_latitude_deg": 48.23, "site_longitude_deg": 16.34}
POINTED = {"ra_deg": 200, "dec_deg": -35, "position_angle_deg": 30, "time": "2019-12-11T15:05:00Z"}


@pytest.fixture
async def api(make_app, anyio_backend):
    async with running(make_app(Recorder)) as client:
        yield client


@pytest.mark.parametrize("mirrored", [False, True])
async def test_a_frame_is_told_where_the_body_should_be(api, mirrored):
    camera = {**SITE, "mirrored": mirrored}
    prior = {"orbit": TLE, "attitude_mode": "sun_pointing"}
    told = await api.estimate(await api.ready_session(camera=camera, prior=prior), **POINTED)
    assert told["assumed"] == ["attitude_mode"]
    held = Recorder.jobs[-1].held
    assert held.mode == "sun_pointing"
    sun = told["light"]["sun"]
    away = -1 if mirrored else 1  # poses of a mirrored image count z towards the observer
    z = rotation_matrices(np.array(held.reference))[:, 2]
    from_earth = sun["x"], sun["y"], away * sun["z"]
    np.testing.assert_allclose(z, from_earth, atol=1e-4)  # the orbit's height is less of the distance


async def test_nadir_is_where_the_earth_is(api):
    prior = {"orbit": TLE, "attitude_mode": "nadir_pointing"}
    await api.estimate(await api.ready_session(camera=SITE, prior=prior), **POINTED)
    held, earth = Recorder.jobs[-1].held, Recorder.jobs[-1].light.earth
    np.testing.assert_allclose(rotation_matrices(np.array(held.reference))[:, 2], earth, atol=1e-4)


async def test_where_it_is_not_known_it_is_not_used(api):
    session_id = await api.ready_session(camera=SITE, prior={"orbit": TLE, "attitude_mode": "yaw_steering"})
    told = await api.estimate(session_id, time=POINTED["time"])  # no orientation
    assert told["assumed"] == [] and Recorder.jobs[-1].held is None
    plain = await api.estimate(await api.ready_session(camera=SITE, prior={"orbit": TLE}), **POINTED)
    assert plain["assumed"] == [] and Recorder.jobs[-1].held is None


async def test_it_needs_the_orbit(api):
    model_id = (await api.model()).json()["model_id"]
    for prior in ({"attitude_mode": "nadir_pointing"}, {"orbit": TLE, "attitude_mode": "spinning"}):
        answer = await api.http.post("/v1/sessions", json={"model_id": model_id, "camera": SITE, "prior": prior})
        assert (answer.status_code, answer.json()["field"]) == (422, "prior.attitude_mode")


async def test_the_published_filter_says_that_it_does_not_use_it(api):
    model_id = (await api.model()).json()["model_id"]
    sections = {
        "camera": SITE,
        "prior": {"orbit": TLE, "attitude_mode": "nadir_pointing"},
        "filter": {"preset": "paper"},
    }
    answer = await api.http.post("/v1/sessions", json={"model_id": model_id, **sections})
    assert answer.status_code == 201, answer.text
    assert "prior.attitude_mode is not for bootstrap, and is not used" in answer.json()["warnings"]
