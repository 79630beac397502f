"""From estimates to a history: where it breaks, which signs, which rates; and the tables of everything."""

import csv
import io
import itertools
from datetime import timedelta

import numpy as np
import pytest
from brahe.ccsds import AEM
from golden import ROTATIONS, START

from service.errors import ConflictError
from service.exports.formats import FORMATS, Subject, export
from service.exports.history import read_history

SUBJECT = Subject("my\nORIGINATOR = me", "", {"panel": "deg", "boom": "units"}, START)


def pose(k: int, rate, known: bool) -> dict:
    w, x, y, z = ROTATIONS[k % 8][0]
    attitude = {"frame": "GCRF", "orientation": {"w": w, "x": x, "y": y, "z": z}}
    if rate is not None:
        attitude["angular_velocity_body_deg_s"] = rate
    numbers = dict.fromkeys(("yaw_deg", "pitch_deg", "roll_deg", "x_px", "y_px", "scale_px"), 1.5)
    orientation = {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}
    return {
        "orientation": orientation,
        **numbers,
        "joints": {"panel": 2.0, "boom": 0.5},
        "attitude": attitude if known else None,
    }


def estimate(k: int, *, status: str = "tracking", rate=None, known: bool = True, seconds: float | None = None) -> dict:
    time = START + timedelta(seconds=k if seconds is None else seconds)
    found = pose(k, rate, known)
    spread = {"orientation_deg": 1.0, "covariance": np.diag([1.0, 4.0, 9.0, 1.0, 1.0, 1.0, 1.0]).tolist()}
    common = {"index": k, "time": time.isoformat(), "status": status, "ess": 10.0, "log_evidence": -1.0}
    return {**common, "best": found, "mean": found, "spread": spread}


def test_the_history_breaks_where_the_object_is_lost_or_its_attitude_unknown():
    states = [estimate(0), estimate(1), estimate(2, status="lost"), estimate(3), estimate(4, known=False), estimate(5)]
    history = read_history(states, "best", "a", "b", START)
    assert [len(segment) for segment in history.segments] == [2, 1, 1]


def test_time_goes_on_and_signs_do_not_jump():
    states = [estimate(5), estimate(6), estimate(6, seconds=5.5), estimate(7)]
    (segment,) = read_history(states, "mean", "a", "b", START).segments
    assert [sample.time.second for sample in segment] == [10, 11, 12]
    assert all(a.quaternion @ b.quaternion >= 0 for a, b in itertools.pairwise(segment))


def test_a_rate_that_is_not_known_is_not_made_up():
    states = [estimate(0), estimate(1, rate=[1.0, 2.0, 3.0])]
    first, second = read_history(states, "best", "a", "b", START).segments[0]
    assert first.rate_deg_s is None
    np.testing.assert_allclose(second.rate_deg_s, [1, 2, 3])
    np.testing.assert_allclose(second.sigma_deg, [1, 2, 3])
    assert "AttitudeTimeQuaternions\n" in export("stk", states, "best", SUBJECT).decode()
    aem = AEM.from_str(export("aem", states, "best", SUBJECT).decode())
    assert [(len(one.states), one.attitude_type) for one in aem.segments] == [
        (1, "QUATERNION"),
        (1, "QUATERNION/ANGVEL"),
    ]


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_is_written(name):
    states = [estimate(k, rate=[0.0, 0.0, 1.0]) for k in range(3)]
    body = export(name, states, "best", SUBJECT)
    if name in ("aem", "apm"):
        assert "\nORIGINATOR = me" not in body.decode()
        assert "OBJECT_NAME = my ORIGINATOR = me" in body.decode()
        assert "OBJECT_ID = UNKNOWN" in body.decode()


@pytest.mark.parametrize("name", ["aem", "acm", "apm", "stk", "czml"])
def test_without_any_attitude_attitude_formats_are_refused(name):
    with pytest.raises(ConflictError):
        export(name, [estimate(0, known=False)], "best", SUBJECT)
    with pytest.raises(ConflictError):
        export(name, [], "best", SUBJECT)


def test_tables_hold_every_frame():
    states = [estimate(k, rate=[0.0, 0.0, k], known=k != 3) for k in range(8)]
    rows = list(csv.DictReader(io.StringIO(export("csv", states, "best", SUBJECT).decode())))
    arrays = np.load(io.BytesIO(export("npz", states, "best", SUBJECT)))
    assert len(rows) == 8 and rows[3]["gcrf_qw"] == "" and np.isnan(arrays["attitude_gcrf"][3]).all()
    for k in (0, 1, 2, 4, 5, 6, 7):
        assert tuple(float(rows[k][f"gcrf_q{axis}"]) for axis in "wxyz") == pytest.approx(ROTATIONS[k][0])
        assert tuple(arrays["attitude_gcrf"][k]) == pytest.approx(ROTATIONS[k][0])
        assert float(rows[k]["body_rate_z_deg_s"]) == arrays["angular_velocity_body_deg_s"][k, 2] == k
    assert (rows[0]["joint:panel_deg"], rows[0]["joint:boom_units"]) == ("2.0", "0.5")
    assert list(arrays["joint_units"]) == ["deg", "units"]
    assert arrays["joints"].shape == (8, 2) and arrays["covariance"].shape == (8, 7, 7)
    assert np.load(io.BytesIO(export("npz", [], "best", SUBJECT)))["orientation"].shape == (0, 4)
