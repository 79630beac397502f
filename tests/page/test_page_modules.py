"""The page's own arithmetic, module by module, in the browser."""

from datetime import UTC, datetime

import numpy as np
import pytest

from service.attitude.camera import Site, horizontal_direction
from service.attitude.sun import sun_from_earth
from service.inference.pose import exp_so3, yaw_pitch_roll_deg


@pytest.fixture(scope="module")
def answers(server, browser):
    """``answers(module, body, given)``: what a function body says of ``given``, with a module of the page as ``m``."""
    page = browser.new_page()
    page.goto(server.url)

    def run(module: str, body: str, given: object = None) -> object:
        source = f'async (given) => {{ const m = await import("/static/js/{module}.js"); {body} }}'
        return page.evaluate(source, given)

    yield run
    page.close()


IMAGE = {"width": 200, "height": 100}


def test_zoom_never_shows_more_than_the_frame(answers):
    def window(box):
        return answers("frame", "return m.windowOn(given[0], 400, 400, given[1])", [IMAGE, box])

    whole = window(None)
    assert whole == {"left": 0, "right": 200, "top": -50, "bottom": 150}
    assert window({"min": {"x": -300, "y": -300}, "max": {"x": 500, "y": 400}}) == whole  # a body larger than the frame
    near = window({"min": {"x": 150, "y": 40}, "max": {"x": 190, "y": 60}})
    assert near == {"left": 145, "right": 195, "top": 25, "bottom": 75}
    edge = window({"min": {"x": 180, "y": 80}, "max": {"x": 220, "y": 100}})
    assert (edge["right"], edge["bottom"]) == (200, 100)  # nothing beyond the frame while there is frame to show


def test_a_pose_fills_the_box_of_its_moved_parts(answers):
    body = """
      const three = await import("/static/vendor/three/three.module.min.js");
      const part = (name) => ({ name, geometry: new three.BoxGeometry(2, 1, 1) });
      const stage = { kind: "revolute", axis: [0, 0, 1], origin: [0, 0, 0], ratio: 1, depth: 0, parts: ["wing"] };
      const model = { centre: [0, 0, 0], joints: [{ name: "hinge", initial: 0, stages: [stage] }] };
      const found = new m.Body(model, [part("body"), part("wing")]).box(given);
      return [found.min.x, found.min.y, found.max.x, found.max.y];"""
    turn = {"w": 0.5**0.5, "x": 0, "y": 0, "z": 0.5**0.5}
    pose = {"orientation": turn, "x_px": 50, "y_px": 60, "scale_px": 10, "joints": {"hinge": 90}}
    assert answers("body", body, pose) == pytest.approx([40, 50, 60, 70])
    pose["joints"] = {"hinge": 0}
    assert answers("body", body, pose) == pytest.approx([45, 50, 55, 70])


def test_the_list_of_sessions_shows_the_newest_of_any_number(answers):
    """The API begins with the oldest; a page of it that was passed is not asked for again."""
    body = """
      const asked = [], api = { json: async (url) => {
        asked.push(url);
        const page = Number(url.split("page=")[1] ?? 0);
        return { sessions: [{ session_id: `${page}` }], next: page < 7 ? `more?page=${page + 1}` : null };
      } };
      const nav = document.createElement("nav");
      nav.innerHTML = "<input><ul></ul>";
      const list = new m.SessionList(nav, api, { choose() {}, changed() {} });
      await list.refresh();
      const first = asked.splice(0).length;
      await list.refresh();
      return { first, again: asked, shown: list.sessions.map((session) => session.session_id) };"""
    found = answers("sessions", body)
    assert found["shown"] == ["7", "6", "5", "4", "3"]
    assert found["first"] == 8 and found["again"] == [f"more?page={page}" for page in range(3, 8)]


def mode(wing: float, boom: float = 1.0) -> dict:
    pose = {"yaw_deg": 10, "pitch_deg": 20, "roll_deg": -30, "joints": {"wing": wing, "boom": boom}}
    return {"pose": pose, "spread": {"orientation_deg": 0.5}}


def test_modes_that_differ_in_a_joint_say_so(answers):
    def texts(*modes):
        return answers("readout", "return m.modeTexts(given, { wing: 'revolute', boom: 'prismatic' })", modes)

    angles = "10.0°, 20.0°, -30.0° ± 0.5°"
    assert texts(mode(5), mode(95)) == [f"{angles} · wing 5.0°", f"{angles} · wing 95.0°"]
    assert texts(mode(5, 1), mode(5, 2)) == [f"{angles} · boom 1.0", f"{angles} · boom 2.0"]
    assert texts(mode(5)) == [angles]
    assert texts() == []


def test_a_plots_range_is_of_what_is_drawn(answers):
    def row(status: str, yaw: float, weight: float = 1.0) -> dict:
        return {"status": status, "yaw": yaw, "modes": [{"weight": weight, "at": {"yaw": yaw}, "spread": {"yaw": 1}}]}

    body = "return m.rangeOf(given, { key: 'yaw', pose: true, value: (row) => row.yaw })"
    tracked = [row("tracking", 10), row("tracking", 20)]
    assert answers("strip", body, tracked) == pytest.approx([9 - 0.96, 21 + 0.96])
    gone = [row(status, 170) for status in ("lost", "no_fit", "no_target")]
    assert answers("strip", body, gone + tracked) == answers("strip", body, tracked)
    assert answers("strip", body, gone) == [0, 1]


def test_what_is_known_of_the_sky_is_told(answers):
    rows = dict(answers("sky_readout", "return m.skyRows(given)", SKY))
    assert rows["Attitude, body to GCRF (w, x, y, z)"] == "1.0000, 0.0000, 0.0000, 0.0000"
    assert rows["Turning in GCRF"] == "5.00 °/s"
    assert rows["Pointing (RA, Dec)"] == "0.000°, 90.000°"
    assert (rows["Range"], rows["Azimuth, elevation"]) == ("812.5 km", "202.25°, 27.50°")
    assert rows["Scale by the range"] == "18.00 px/unit, seen 1.0 % off"
    assert rows["Phase angle"] == "100.8°, Sun by time and pointing"
    assert rows["Light"] == "in the Earth’s shadow"
    nothing = {"best": {"attitude": None}, "camera": None, "orbit": None, "light": {"sun": None, "sunlit": None}}
    assert answers("sky_readout", "return m.skyRows(given)", nothing) == []


def test_a_motion_is_told_in_rows(answers):
    found = {
        "model": "constant_rate",
        "probabilities": {"constant_rate": 0.97, "tumbling": 0.03},
        "relative_to": "camera",
        "rate_deg_s": 3.7417,
        "rate_sigma_deg_s": 0.0123,
        "period_s": None,
        "axis_body": {"x": 0.6, "y": -0.8, "z": 0},
        "axis_body_sigma_deg": 0.254,
        "axis_gcrf": None,
        "inertia": None,
        "frames": {"stored": 40, "used": 38, "explained": 1},
        "warnings": ["against the camera"],
        "attitude_mode": {
            "mode": "nadir_pointing",
            "probabilities": {"nadir_pointing": 0.996},
            "offset_deg": 3.12,
            "sigma_deg": 0.4,
            "body_axis": "+z",
        },
        "joints": [
            {"name": "alpha", "law": "sun_tracking", "probabilities": {"sun_tracking": 0.9}}
            | {"value_deg": None, "offset_deg": -3.2, "sigma_deg": 0.5},
            {"name": "dish", "law": "neither", "probabilities": {"neither": 0.8}}
            | {"value_deg": None, "offset_deg": None, "sigma_deg": None},
        ],
    }
    rows = answers("spin", "return m.spinRows(given)", found)
    assert rows == [
        ["It", "turns at a constant rate, 97 %"],
        ["Rate", "3.7417 ± 0.0123 °/s against the camera"],
        ["Period", "no turning seen"],
        ["Axis in the body", "0.600, -0.800, 0.000 ± 0.25°"],
        ["Attitude mode", "nadir pointing, 99.6 %, +z, 3.12 ± 0.40° off"],
        ["Joint alpha", "sun tracking, 90 %, -3.20 ± 0.50° from the Sun"],
        ["Joint dish", "neither, 80 %"],
        ["Frames", "38 of 40, 100 % of these explained"],
        ["Note", "against the camera"],
    ]


def test_grey_levels_go_through_contrast_and_colours(answers):
    def colour(level, gain, name):
        body = "const [level, ...how] = given; return [...m.table(...how)].slice(3 * level, 3 * level + 3);"
        return answers("tone", body, [level, gain, name])

    assert colour(100, 1, "grey") == [100, 100, 100]
    assert colour(100, 2, "grey") == [200, 200, 200]
    assert colour(200, 2, "grey") == [255, 255, 255]
    assert colour(0, 1, "inverted") == [255, 255, 255]
    assert colour(255, 1, "viridis") == [0xFD, 0xE7, 0x25]


@pytest.mark.parametrize("moment", ["2026-11-21T17:30:44", "2019-06-01T03:00:00", "2031-03-20T12:00:00"])
def test_the_sun_stands_where_the_service_has_it(answers, moment):
    at = datetime.fromisoformat(moment).replace(tzinfo=UTC)
    found = answers("ephemeris", "return m.sunAt(...given)", [at.timestamp(), 48.23, 16.34])
    drawn = horizontal_direction(found["azimuth"], found["elevation"], Site(48.23, 16.34, 250.0), at)
    true = sun_from_earth(at)
    assert np.rad2deg(np.arccos(drawn @ true / np.linalg.norm(true))) < 0.05


def test_the_earths_shadow_is_opposite_to_the_sun(answers):
    def shadow(azimuth, elevation, radius, sun_elevation):
        body = """const [seen, radius, sun] = given;
          return m.inShadow(m.direction(seen), radius, m.direction(sun));"""
        seen = {"azimuth": azimuth, "elevation": elevation}
        return answers("ephemeris", body, [seen, radius, {"azimuth": 270, "elevation": sun_elevation}])

    assert shadow(0, 90, 6771, -60)  # 400 km above, at night
    assert not shadow(0, 90, 42164, -60)  # far out it is narrow
    assert shadow(90, 20, 6771, -15) and not shadow(270, 20, 6771, -15)  # at dusk it rises in the east
    assert not shadow(0, 90, 6771, 30)
    assert answers("ephemeris", "return m.radiusOf(500, 90)") == 6871


TRUTH = """frame,time_s,qx,qy,qz,qw,x_px,y_px,scale_px,visible,wing
3,0.3,0,0,0,1,10,20,5,1,-7.5
4,0.4,0,0,0,1,10,20,5,0,-7
"""


def test_a_truth_is_read(answers):
    body = "const read = m.readTruth(given, 2); return [1, 2].map((k) => read.rowOf(k)?.best ?? null);"
    first, hidden = answers("truth", body, TRUTH)
    assert first == {"yaw": 0, "pitch": 0, "roll": 0, "x": 10, "y": 20, "scale": 5, "joint:wing": -7.5}
    assert hidden is None  # the object is not visible in it
    said = answers("truth", "try { m.readTruth(given); } catch (error) { return error.message; }", "frame,qx\n0,1")
    assert said == "the truth lacks the columns qy, qz, qw, x_px, y_px, scale_px"


def test_angles_are_those_of_the_service(answers):
    turns = exp_so3(np.array([[0.3, -1.2, 2.0], [0.0, np.pi / 2, 0.0], [-2.5, 0.1, 0.4]]))
    given = [dict(zip("wxyz", turn.tolist(), strict=True)) for turn in turns]
    found = answers("rotation", "return given.map(m.yawPitchRoll)", given)
    np.testing.assert_allclose(
        [[one["yaw_deg"], one["pitch_deg"], one["roll_deg"]] for one in found], yaw_pitch_roll_deg(turns), atol=1e-6
    )


AS_IT_IS = {"w": 1, "x": 0, "y": 0, "z": 0}
SKY = {
    "best": {
        "scale_px": 18.18,
        "attitude": {"frame": "GCRF", "orientation": AS_IT_IS, "angular_velocity_gcrf_deg_s": [3, 0, 4]},
    },
    "camera": {"orientation": AS_IT_IS, "mirrored": False},
    "orbit": {
        "range_km": 812.5,
        "azimuth_deg": 202.25,
        "elevation_deg": 27.5,
        "elements_age_days": 1.25,
        "expected_scale_px": 18.0,
    },
    "light": {"sun": {"x": 0, "y": 0, "z": 1}, "phase_deg": 100.8, "source": "ephemeris", "sunlit": False},
}
