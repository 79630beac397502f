"""AEM and APM, read by a program of other people."""

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from brahe.ccsds import AEM, APM
from golden import RATES, ROTATIONS, START, history, require_axes

from service.exports.ccsds import write_aem, write_apm


def require_quaternion(quaternion, index: int) -> None:
    """The reader's own idea of a quaternion: the rows of its matrix are the axes of frame B in frame A."""
    matrix = quaternion.to_rotation_matrix().to_matrix()
    require_axes(matrix[0], matrix[1], index)


@pytest.mark.parametrize("rates", [True, False])
def test_every_rotation_is_read_back(rates):
    message = AEM.from_str(write_aem(history(rates=rates)))
    states = [state for segment in message.segments for state in segment.states]
    assert len(states) == len(ROTATIONS)
    for k, state in enumerate(states):
        require_quaternion(state.quaternion, k)
        if rates:
            np.testing.assert_allclose(np.rad2deg(state.angular_velocity), RATES[k], atol=1e-9)
        else:
            assert state.angular_velocity is None


def test_segments_and_frames_are_named():
    first, second = AEM.from_str(write_aem(history())).segments
    assert (len(first.states), len(second.states)) == (5, 3)
    assert (first.ref_frame_a, first.ref_frame_b, first.time_system) == ("GCRF", "SC_BODY_1", "UTC")
    assert (first.attitude_type, first.angvel_frame) == ("QUATERNION/ANGVEL", "SC_BODY_1")
    assert (first.object_name, first.object_id) == ("TOPEX", "1992-052A")
    assert second.start_time - first.start_time == pytest.approx(5.0)
    assert first.states[0].epoch.isostring() == "2026-11-20T03:04:05Z"
    assert first.states[0].epoch.nanosecond() == pytest.approx(2.5e8)


@pytest.mark.parametrize("index", range(8))
def test_apm_holds_the_newest_attitude(index):
    one = history()
    sample = [s for segment in one.segments for s in segment][index]
    message = APM.from_str(write_apm(type(one)(one.name, one.object_id, one.created, ((sample,),))))
    (state,) = message.quaternion_states
    assert (state.ref_frame_a, state.ref_frame_b) == ("GCRF", "SC_BODY_1")
    require_quaternion(state.quaternion, index)
    np.testing.assert_allclose(np.rad2deg(message.angular_velocities[0].angular_velocity), RATES[index], atol=1e-9)


def test_lines_are_where_the_standard_wants_them():
    lines = write_aem(history()).splitlines()
    assert lines[:2] == ["CCSDS_AEM_VERS = 2.0", "CREATION_DATE = 2026-11-20T03:04:05.250000"]
    assert datetime.fromisoformat(lines[1].split(" = ")[1]).replace(tzinfo=UTC) == START
    # Q1 Q2 Q3 QC: the scalar of "90 degrees about x" comes fourth.
    row = next(line for line in lines if line.startswith("2026-11-20T03:04:06"))
    assert [float(value) for value in row.split()[1:5]] == pytest.approx([0.5**0.5, 0, 0, 0.5**0.5])


def test_spreads_are_comments_before_the_rows():
    one = history(breaks=())
    samples = tuple(replace(sample, sigma_deg=np.array([0.1, 0.2, 0.3])) for sample in one.segments[0])
    text = write_aem(replace(one, segments=(samples,)))
    lines = text.splitlines()
    at = lines.index("DATA_START")
    assert lines[at + 1] == "COMMENT Standard deviations about the body axes X, Y, Z in degrees, by epoch:"
    assert lines[at + 2] == "COMMENT 2026-11-20T03:04:05.250000 0.100000 0.200000 0.300000"
    assert not lines[at + 2 + len(samples)].startswith("COMMENT")
    (segment,) = AEM.from_str(text).segments
    assert len(segment.states) == len(samples)
