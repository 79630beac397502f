"""An orbit with the session: range and age of the data in every estimate, and the scale that the tracker is held to."""

from dataclasses import replace
from datetime import datetime

import numpy as np
import pytest
from api_client import running
from fake_worker import Recorder

from service.api.schemas import Estimate
from service.attitude.camera import Site, horizontal_direction

pytestmark = pytest.mark.anyio
TLE = (
    "1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991\n"
    "2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482"
)
SITE = {"site_latitude_deg": 48.23, "site_longitude_deg": 16.34, "site_height_m": 250.0}
CAMERA = {**SITE, "pixel_scale_arcsec": 0.5}
HIGH, LOW = "2019-12-11T15:05:00Z", "2019-12-11T15:50:00Z"


@pytest.fixture
async def api(make_app, anyio_backend):
    async with running(make_app(Recorder)) as client:
        yield client


async def test_range_and_expected_scale(api):
    prior = {"orbit": TLE, "unit_m": 2.0, "scale_tolerance": 0.05}
    session_id = await api.ready_session(camera=CAMERA, prior=prior)
    told = Estimate.model_validate((await api.post(session_id, 0, time=HIGH)).json())
    orbit = told.orbit
    assert orbit is not None and orbit.elevation_deg > 60 and 400 < orbit.range_km < 500
    assert orbit.elements_age_days == pytest.approx(1.935, abs=0.01)
    assert orbit.earth_orientation.known
    expected = 2.0 / (orbit.range_km * 1e3 * np.deg2rad(0.5 / 3600))
    assert orbit.expected_scale_px == pytest.approx(expected)
    assert Recorder.jobs[-1].scale_px == pytest.approx((0.95 * expected, 1.05 * expected))
    below = Estimate.model_validate((await api.post(session_id, 1, time=LOW)).json())
    assert below.orbit.elevation_deg < 0 and below.orbit.expected_scale_px is None
    assert Recorder.jobs[-1].scale_px is None


async def test_without_a_unit_there_is_a_range_and_no_scale(api):
    session_id = await api.ready_session(camera=CAMERA, prior={"orbit": TLE})
    told = (await api.post(session_id, 0, time=HIGH)).json()["orbit"]
    assert told["range_km"] > 0 and told["expected_scale_px"] is None
    timeless = await api.post(session_id, 1)
    assert (timeless.status_code, timeless.json()["field"]) == (422, "query:time")
    plain = await api.ready_session()
    assert "orbit" not in (await api.post(plain, 0)).json()


async def test_what_is_refused_when_the_session_is_begun(api):
    model_id = (await api.model()).json()["model_id"]
    for sections in (
        {"prior": {"orbit": "hello"}, "camera": SITE},
        {"prior": {"orbit": TLE}},
        {"prior": {"unit_m": 0.0}},
    ):
        answer = await api.http.post("/v1/sessions", json={"model_id": model_id, **sections})
        assert (answer.status_code, answer.json()["type"]) == (422, "urn:skypose:problem:invalid-configuration")
        assert "Value error" not in answer.text and not answer.json()["detail"].startswith(":")
    siteless = (await api.http.post("/v1/sessions", json={"model_id": model_id, "prior": {"orbit": TLE}})).json()
    assert siteless["field"] == "prior.orbit" and siteless["detail"].startswith("prior.orbit: needs the site: camera.")


async def test_a_mistyped_orbit_is_told_when_the_session_is_begun(api):
    model_id = (await api.model()).json()["model_id"]
    for orbit, count in ((TLE, 0), (TLE.replace("482", "483"), 1)):
        sections = {"prior": {"orbit": orbit}, "camera": SITE}
        made = (await api.http.post("/v1/sessions", json={"model_id": model_id, **sections})).json()
        said = [one for one in made["warnings"] if "checksum" in one]
        assert len(said) == count and all("line" in one for one in said)


async def test_what_does_not_agree_is_told(api):
    session_id = await api.ready_session(camera={**CAMERA, "mount": "altaz", "up_angle_deg": 0.0}, prior={"orbit": TLE})
    orbit = (await api.post(session_id, 0, time=HIGH, az_deg=0, el_deg=45)).json()["orbit"]
    towards = {"az_deg": orbit["azimuth_deg"], "el_deg": orbit["elevation_deg"]}
    again = await api.ready_session(camera={**CAMERA, "mount": "altaz", "up_angle_deg": 0.0}, prior={"orbit": TLE})
    assert (await api.post(again, 0, time=HIGH, **towards)).json()["warnings"] == []
    aside = {**towards, "el_deg": towards["el_deg"] - 3.0}
    (told,) = (await api.post(again, 1, time=HIGH, **aside)).json()["warnings"]
    assert told.startswith("the camera points 3.0° away")
    below = (await api.post(again, 2, time=LOW, **aside)).json()["warnings"]
    assert below[0].startswith("the orbit puts the object") and "horizon" in below[0]
    old = (await api.post(again, 3, time="2020-03-01T00:00:00Z", **aside)).json()["warnings"]
    assert any("elements are 8" in one for one in old)
    plain = await api.ready_session()
    assert (await api.post(plain, 0)).json()["warnings"] == []


async def test_a_direction_alone_is_compared_with_the_orbit(api):
    session_id = await api.ready_session(camera=CAMERA, prior={"orbit": TLE})
    first = (await api.post(session_id, 0, time=HIGH)).json()
    orbit, at = first["orbit"], datetime.fromisoformat(HIGH)
    assert first["warnings"] == [] and first.get("camera") is None
    sky = {"az_deg": orbit["azimuth_deg"], "el_deg": orbit["elevation_deg"]}
    site = Site(SITE["site_latitude_deg"], SITE["site_longitude_deg"])
    x, y, z = horizontal_direction(*sky.values(), site, at)
    stars = {"ra_deg": float(np.rad2deg(np.arctan2(y, x)) % 360), "dec_deg": float(np.rad2deg(np.arcsin(z)))}
    for n, (towards, up) in enumerate(((sky, "el_deg"), (stars, "dec_deg"))):
        there = await api.post(session_id, 1 + 2 * n, time=HIGH, **towards)
        assert there.json()["warnings"] == []
        aside = await api.post(session_id, 2 + 2 * n, time=HIGH, **{**towards, up: towards[up] - 3.0})
        (told,) = aside.json()["warnings"]
        assert told.startswith("the camera points 3.0° away")


async def test_a_size_that_no_pose_can_fit_is_told_by_the_light(make_app, anyio_backend):
    class Lit(Recorder):
        """Finds nothing that fits, in light of so many times the extent that the scale's bounds let the body have."""

        times, status = 1.0, "no_target"

        def track(self, job):
            report, middle = super().track(job), sum(job.scale_px) / 2
            best = replace(report.estimate.best, scale=middle)
            told = {"status": self.status, "best": best, "light_scale": middle * self.times}
            return replace(report, estimate=replace(report.estimate, **told))

    async with running(make_app(Lit)) as api:
        session_id = await api.ready_session(camera=CAMERA, prior={"orbit": TLE, "unit_m": 2.0})

        async def told(index, times, status="no_target"):
            Lit.times, Lit.status = times, status
            return (await api.post(session_id, index, time=HIGH)).json()["warnings"]

        assert await told(0, 1.0) == await told(1, 0.5) == await told(2, 3.0, "tracking") == []
        for n, (times, said) in enumerate(((2.3, "2.3"), (1500.0, "1,500"), (0.001, "0.001"))):
            expected = f"the light is {said} times as long as the body is by range, pixel scale and the model's unit"
            assert await told(3 + n, times) == [expected]


@pytest.mark.parametrize("status", ["tracking", "no_fit", "acquiring", "lost"])
async def test_a_size_that_does_not_agree_is_told(make_app, anyio_backend, status):
    class Sized(Recorder):
        """Finds the body where the scale's bounds put it, or half as large again."""

        times = 1.0

        def track(self, job):
            report, middle = super().track(job), sum(job.scale_px) / 2
            best = replace(report.estimate.best, scale=middle * self.times)
            return replace(report, estimate=replace(report.estimate, status=status, best=best))

    async with running(make_app(Sized)) as api:
        session_id = await api.ready_session(camera=CAMERA, prior={"orbit": TLE, "unit_m": 2.0})
        assert (await api.post(session_id, 0, time=HIGH)).json()["warnings"] == []
        Sized.times = 1.06  # within what was told, but for what does not fit
        near = (await api.post(session_id, 1, time=HIGH)).json()["warnings"]
        assert bool(near) == (status == "no_fit")
        Sized.times = 1.5
        told = (await api.post(session_id, 2, time=HIGH)).json()["warnings"]
    expected = {
        "no_fit": ["nothing fits within 10% of the size by range, pixel scale and the model's unit"],
        "lost": [],
    }
    larger = ["the body is 50% larger than range, pixel scale and the model's unit say, or more"]
    assert told == expected.get(status, larger)
