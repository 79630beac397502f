"""A pass over a real place: pointing, range, Sun and shadow are the attitude room's, and the truth turns with them."""

import csv
import json
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from typer.testing import CliRunner

from service.attitude.camera import Site, direction, equatorial_camera
from service.attitude.earth import gcrf_to_itrf
from service.attitude.orbit import Orbit
from service.attitude.sun import sun_from_earth
from service.bench.cases import ModelShelf
from service.bench.folder import find_sequences
from service.bench.told import Told
from service.cli import app
from service.inference.pose import angle_between, from_matrices, rotation_matrices
from service.sessions.config import effective
from service.simulate.folder import write_sequence
from service.simulate.motion import Motion
from service.simulate.overflight import Overflight, OverflightError
from service.simulate.scenario import PRESETS
from service.simulate.sequence import SimulatedPass
from service.workers.tracker import Tracker

TLE = (
    "1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991\n"
    "2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482"
)
VIENNA = Site(48.23, 16.34, 250.0)
HIGH = datetime(2019, 12, 11, 15, 5, tzinfo=UTC)
MOTION = Motion(frames=5, frame_interval_s=10.0, rate_deg_s=0.3, scale_drift_per_s=0.5, wobble_px=0.0)


def passed(demo, start=HIGH, motion=MOTION, up_angle_deg=25.0, site=VIENNA):
    _, mesh, articulation = demo
    over = Overflight(site, TLE, start, up_angle_deg)
    base = PRESETS["night"]()
    return SimulatedPass(mesh, articulation, replace(base, size=(64, 64), motion=motion, overflight=over))


def test_the_camera_follows_the_satellite_and_its_up_keeps_to_the_pole(demo):
    simulated = passed(demo)
    first, last = simulated.looks[0], simulated.looks[-1]
    assert np.rad2deg(np.arccos(direction(first.ra_deg, first.dec_deg) @ direction(last.ra_deg, last.dec_deg))) > 3
    for look in simulated.looks:
        expected = equatorial_camera(look.ra_deg, look.dec_deg, 25.0)
        np.testing.assert_allclose(look.camera.to_gcrf, expected, atol=1e-9)


def test_the_body_keeps_its_own_rate_among_the_stars(demo):
    simulated = passed(demo)
    cameras = np.stack([look.camera.to_gcrf for look in simulated.looks])
    among_stars = from_matrices(cameras @ rotation_matrices(simulated.track.poses.quaternion))
    np.testing.assert_allclose(np.rad2deg(angle_between(among_stars[1:], among_stars[:-1])), 3.0, atol=1e-6)
    seen = simulated.track.poses.quaternion
    assert np.ptp(np.rad2deg(angle_between(seen[1:], seen[:-1]))) > 0.1


def test_the_scale_follows_the_range_and_no_other_drift(demo):
    simulated = passed(demo)
    ranges = np.array([look.sighting.range_km for look in simulated.looks])
    assert np.ptp(ranges) > 20
    scale = np.exp(simulated.track.poses.log_scale)
    np.testing.assert_allclose(scale * ranges, scale[0] * ranges[0], rtol=1e-12)
    assert 2 * simulated.mesh.radius * scale[0] == pytest.approx(0.65 * 64)


def test_several_sites_see_one_object(demo, tmp_path):
    """Vienna, and 300 km to the west: one attitude among the stars, another direction, other noise."""
    out, tle = tmp_path / "both", tmp_path / "iss.tle"
    tle.write_text(TLE)
    arguments = ["simulate", "--out", str(out), "--preset", "night", "--frames", "3", "--size", "64x64"]
    arguments += ["--tle", str(tle), "--time", HIGH.isoformat(), "--site", "48.23,16.34,250", "--site", "48.0,12.3,500"]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    rows, truths = (
        [list(csv.DictReader((out / f"site_{n}" / name).read_text().splitlines())) for n in (0, 1)]
        for name in ("pointing.csv", "truth.csv")
    )
    attitudes = [np.array([[float(row[f"gcrf_q{axis}"]) for axis in "wxyz"] for row in one]) for one in rows]
    assert np.rad2deg(angle_between(*attitudes)).max() < 1e-3  # but for what a body aside in the image is turned
    scaled = [
        float(truth[k]["scale_px"]) * float(row[k]["range_km"])
        for truth, row in zip(truths, rows, strict=True)
        for k in (0, 2)
    ]
    assert scaled == pytest.approx([scaled[0]] * 4, rel=1e-5)
    one, other = (direction(float(row[0]["ra_deg"]), float(row[0]["dec_deg"])) for row in rows)
    assert np.rad2deg(np.arccos(one @ other)) > 20
    images = [(out / f"site_{n}" / "background" / "000.png").read_bytes() for n in (0, 1)]
    assert images[0] != images[1]


def test_the_sun_in_the_camera_is_the_sun_among_the_stars(demo):
    simulated = passed(demo)
    for k, look in enumerate(simulated.looks):
        sun = sun_from_earth(look.moment)
        np.testing.assert_allclose(
            look.camera.to_gcrf @ simulated.light(k).direction(), sun / np.linalg.norm(sun), atol=1e-9
        )
        place = np.array(look.sighting.place_km)
        earth = look.camera.to_gcrf @ np.array(look.light.towards_earth)
        np.testing.assert_allclose(earth, -place / np.linalg.norm(place), atol=1e-9)


def test_in_the_earths_shadow_the_body_is_dark(demo):
    dark = HIGH.replace(minute=20)
    x, y, z = gcrf_to_itrf(dark) @ np.array(Orbit(TLE).seen_from(VIENNA, dark).place_km)
    below = Site(float(np.rad2deg(np.arctan2(z, np.hypot(x, y)))), float(np.rad2deg(np.arctan2(y, x))))
    one = replace(MOTION, frames=1)
    unlit, lit = passed(demo, dark, one, site=below), passed(demo, motion=one)
    assert (unlit.looks[0].sunlit, lit.looks[0].sunlit) == (0, 1)
    assert unlit.picture(0).radiance.max() < 0.1 * lit.picture(0).radiance.max()


def test_a_satellite_below_the_horizon_is_refused(demo):
    with pytest.raises(OverflightError, match="below the horizon"):
        passed(demo, HIGH.replace(minute=50))


def test_the_folder_tells_a_session_all_that_it_can_be_told(demo, tmp_path):
    simulated = passed(demo)
    write_sequence(simulated, tmp_path / "a", "demo.glb", demo[0])
    case = json.loads((tmp_path / "a" / "case.json").read_text())
    assert (case["tle"], case["time"], case["pointing"]) == (TLE, "2019-12-11T15:05:00.000000Z", "pointing.csv")
    assert case["site"] == {"latitude_deg": 48.23, "longitude_deg": 16.34, "height_m": 250.0}
    radians = np.deg2rad(case["camera"]["pixel_scale_arcsec"] / 3600)
    scale = case["unit_m"] / (simulated.looks[0].sighting.range_km * 1e3 * radians)
    assert scale == pytest.approx(np.exp(simulated.track.poses.log_scale[0]), rel=1e-6)
    np.testing.assert_allclose(case["light"]["towards_sun"], simulated.light(0).direction(), atol=1e-6)
    with (tmp_path / "a" / "pointing.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["time"] for row in rows][-1] == "2019-12-11T15:05:40.000000Z"
    for row, look in zip(rows, simulated.looks, strict=True):
        assert float(row["ra_deg"]) == pytest.approx(look.ra_deg, abs=1e-6)
        assert float(row["position_angle_deg"]) == 25.0
        assert float(row["sunlit"]) == look.sunlit
    truth = np.array([[float(row[f"gcrf_q{axis}"]) for axis in "wxyz"] for row in rows])
    turned = np.rad2deg(angle_between(truth[1:], truth[:-1]))
    np.testing.assert_allclose(turned, 3.0, atol=1e-3)  # the body's own rate, 0.3 deg/s for ten seconds
    cameras = np.stack([look.camera.to_gcrf for look in simulated.looks])
    on_axis = from_matrices(cameras @ rotation_matrices(simulated.track.poses.quaternion))
    assert np.rad2deg(angle_between(truth, on_axis)).max() < 1 / 3600
    effective(
        {"camera": {**{f"site_{k}": v for k, v in case["site"].items()}, **case["camera"]}}
    )  # as a session has it


def test_a_bench_is_told_the_light_of_each_frame(demo, tmp_path):
    data, _, _ = demo
    simulated = passed(demo, motion=replace(MOTION, frames=3, frame_interval_s=30.0))
    write_sequence(simulated, tmp_path / "pass", "demo.glb", data)
    case = find_sequences(tmp_path)[0].case(ModelShelf(Tracker()))
    seen = [truth.light for _, truth in case.frames()]
    assert len(seen) == 3
    for k, light in enumerate(seen):
        np.testing.assert_allclose(light.towards_sun, simulated.light(k).direction(), atol=2e-5)
        np.testing.assert_allclose(light.earth, simulated.light(k).towards_earth, atol=1e-5)
        assert light.earthshine == pytest.approx(simulated.light(k).earth, rel=1e-6)
    assert np.linalg.norm(np.subtract(seen[0].towards_sun, seen[2].towards_sun)) > 0.05
    _, third = list(case.frames())[2]
    assert Told(sun=False).light_at(third) is None
    off = Told(sun_off_deg=5.0).light_at(third).towards_sun
    assert np.dot(off, seen[2].towards_sun) == pytest.approx(np.cos(np.deg2rad(5.0)))
    (tmp_path / "pass" / "frames" / "001.png").unlink()  # no frame is taken for another
    with pytest.raises(FileNotFoundError, match=r"001\.png"):
        list(case.frames())


def test_names_of_many_frames_stay_in_order(demo, tmp_path):
    data, _, _ = demo
    simulated = passed(demo, motion=replace(MOTION, frames=1001, frame_interval_s=0.01))
    few = iter([np.zeros((4, 4), np.uint8)] * 1001)
    simulated.frames = lambda: few
    write_sequence(simulated, tmp_path, "demo.glb", data)
    names = [path.name for path in sorted((tmp_path / "frames").iterdir())]
    assert (names[0], names[-1], len(names)) == ("0000.png", "1000.png", 1001)


def test_on_the_command_line(tmp_path):
    (tmp_path / "iss.tle").write_text(TLE)
    small = ["simulate", "--out", str(tmp_path / "a"), "--frames", "2", "--size", "48x48"]
    real = ["--site", "48.23,16.34,250", "--tle", str(tmp_path / "iss.tle")]
    result = CliRunner().invoke(app, [*small, *real, "--time", "2019-12-11T15:05:00", "--materials", "mixed"])
    assert result.exit_code == 0, result.output
    case = json.loads((tmp_path / "a" / "case.json").read_text())
    assert (case["materials"], case["time"]) == ("mixed", "2019-12-11T15:05:00.000000Z")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--site", "48,16,0"], "go together"),
        (["--site", "48", "--tle", "TLE", "--time", "2019-12-11"], "no site"),
        (["--site", "98,16,0", "--tle", "TLE", "--time", "2019-12-11"], "no place on the Earth"),
        (["--site", "48,16,0", "--tle", "TLE", "--time", "noon"], "no time"),
        (["--site", "48,16,0", "--tle", "gone", "--time", "2019-12-11"], "gone"),
        (["--site", "48.23,16.34", "--tle", "TLE", "--time", "2019-12-11T15:50:00Z"], "below the horizon"),
        (["--materials", "wood"], "painted, mixed"),
    ],
)
def test_refusals_say_why(tmp_path, arguments, message):
    (tmp_path / "TLE").write_text(TLE)
    given = [str(tmp_path / word) if word in ("TLE", "gone") else word for word in arguments]
    base = ["simulate", "--out", str(tmp_path / "a"), "--frames", "1", "--size", "48x48"]
    result = CliRunner().invoke(app, [*base, *given], env={"COLUMNS": "300", "TERM": "dumb"})
    assert result.exit_code != 0
    assert message in result.output
