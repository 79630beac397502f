"""Charts of a report: round ticks, curves that break where nothing is known."""

import re

import numpy as np
import pytest

from service.report.charts import Line, chart, ticks
from service.report.curves import on_sphere_deg


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0.0, 1.0, [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]),
        (-90.0, 90.0, [-50.0, 0.0, 50.0]),
        (0.0012, 0.0019, [0.0012, 0.0014, 0.0016, 0.0018]),
    ],
)
def test_ticks_are_round_numbers(low, high, expected):
    assert ticks(low, high) == pytest.approx(expected)


def curves(picture: str) -> list[int]:
    """Points of each curve."""
    return [len(points.split()) for points in re.findall(r'<polyline points="([^"]+)"', picture)]


def test_a_curve_breaks_where_nothing_is_known_and_where_an_angle_wraps():
    seconds = np.arange(8.0)
    values = np.array([350.0, 355.0, 0.0, 5.0, np.nan, 10.0, np.nan, 20.0])
    line = Line("x", "#000", values, np.full(8, 2.0))
    picture = chart("an angle", seconds, [line], wraps=360.0)
    assert curves(picture) == [2, 2]
    assert picture.count("<circle") == 2  # lone points are dots
    assert picture.count("<polygon") == 2


def test_what_is_never_known_is_an_empty_chart():
    picture = chart("nothing", np.arange(3.0), [Line("x", "#000", np.full(3, np.nan))])
    assert curves(picture) == []
    assert "<svg" in picture


def test_a_single_frame_has_a_chart():
    picture = chart("one", np.zeros(1), [Line("x", "#000", np.ones(1), np.ones(1))])
    assert picture.count("<circle") == 1


def test_text_for_readers_is_escaped():
    assert "<b>" not in chart("<b>", np.arange(2.0), [Line("x", "#000", np.ones(2))])


def test_places_on_a_sphere():
    found = on_sphere_deg(np.array([[1.0, 0, 0], [0, -2, 0], [0, 1, 1], [0, 0, -1]]))
    np.testing.assert_allclose(found, [[0, 0], [270, 0], [90, 45], [0, -90]], atol=1e-12)
