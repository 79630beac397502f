"""STK attitude files, read by the rules of the format's description."""

from datetime import UTC, datetime

import numpy as np
import pytest
from golden import RATES, START, history, require_axes

from service.exports.stk import write_stk


def read_attitude(text: str) -> tuple[dict[str, str], str, np.ndarray]:
    """Keywords, the name of the table, and its rows."""
    lines = text.splitlines()
    assert lines[0].startswith("stk.v.") and lines[1] == "BEGIN Attitude" and lines[-1] == "END Attitude"
    table = next(k for k, line in enumerate(lines) if line.startswith("AttitudeTime"))
    keywords = dict(line.split(maxsplit=1) for line in lines[2:table] if " " in line)
    return keywords, lines[table], np.array([[float(v) for v in line.split()] for line in lines[table + 1 : -1]])


def rotated(vector, q1, q2, q3, q4):
    """Components in body axes of a vector given in reference axes: the axes are turned by the quaternion."""
    v = np.array([q1, q2, q3])
    return vector * (q4**2 - v @ v) + 2 * v * (v @ vector) - 2 * q4 * np.cross(v, vector)


@pytest.mark.parametrize("rates", [True, False])
def test_every_rotation_takes_reference_axes_to_the_bodys(rates):
    keywords, table, rows = read_attitude(write_stk(history(rates=rates)))
    assert int(keywords["NumberOfAttitudePoints"]) == len(rows) == 8
    assert (keywords["CentralBody"], keywords["CoordinateAxes"]) == ("Earth", "ICRF")
    assert table == ("AttitudeTimeQuatAngVels" if rates else "AttitudeTimeQuaternions")
    np.testing.assert_allclose(rows[:, 0], range(8))
    for k, row in enumerate(rows):
        to_body = np.column_stack([rotated(axis, *row[1:5]) for axis in np.eye(3)])
        require_axes(to_body[0], to_body[1], k)
        if rates:
            np.testing.assert_allclose(row[5:], RATES[k])


def test_epoch_and_breaks():
    text = write_stk(history(breaks=(3, 6)))
    epoch = read_attitude(text)[0]["ScenarioEpoch"]
    assert datetime.strptime(epoch, "%d %b %Y %H:%M:%S.%f").replace(tzinfo=UTC) == START
    lines = text.splitlines()
    at = lines.index("SegmentBoundaryTimes")
    assert lines[at + 1 : at + 3] == ["2.000000", "5.000000"]
    assert "SegmentBoundaryTimes" not in write_stk(history(breaks=()))
