"""The report of an object: its answer in two sentences, and what the charts hold."""

import re
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from service.report.spin import ObjectFacts, object_html, spin_sentence

START = datetime(2026, 11, 20, 3, 4, 5, tzinfo=UTC)
AXIS = {"x": 0.6, "y": 0.0, "z": 0.8}


def spin(change_ms: float = 36.0, passes: int = 5) -> dict:
    one = {"model": "constant_rate", "rate_deg_s": 3.0, "rate_sigma_deg_s": 0.01, "period_sigma_s": 0.4}
    one |= {"axis_gcrf": AXIS, "turns_since_last_sigma": None, "swing_since_last_deg": None}
    days = np.arange(passes) * 1.5
    return {
        "object_id": "a",
        "epoch": (START + timedelta(days=days.mean())).isoformat(),
        "rate_deg_s": 3.0,
        "rate_sigma_deg_s": 1e-7,
        "period_s": 120.0,
        "period_sigma_s": 7e-6,
        "period_change_s_per_day": 1e-3 * change_ms,
        "period_change_sigma_s_per_day": 1e-4,
        "axis_gcrf": AXIS,
        "axis_gcrf_sigma_deg": 0.2,
        "scale": 1.0,
        "passes": [
            {
                **one,
                "pass": k,
                "epoch": (START + timedelta(days=day)).isoformat(),
                "period_s": 120.0 + 0.1 * k,
                "axis_gcrf": AXIS | {"y": 0.002 * (-1) ** k},
                "turns_since_last": None if k in (0, 2) else 1080.25,
            }
            for k, day in enumerate(days)
        ],
        "left_out": [],
        "warnings": [],
    }


@pytest.mark.parametrize(
    ("change_ms", "told"),
    [
        (36.0, "slower by 36.00 ± 0.10 ms a day."),
        (-36.0, "faster by 36.00 ± 0.10 ms a day."),
        (0.2, "no change of the period is seen (0.20 ± 0.10 ms a day)."),
    ],
)
def test_the_trend_is_told_in_words(change_ms, told):
    said = spin_sentence(spin(change_ms), "")
    assert said.startswith("It turns once in 120.000000 ± 0.000007 s, about right ascension 0.0°, declination +53.1°")
    assert said.endswith(told)


def test_each_pass_has_its_bar_and_what_is_not_counted_says_so():
    tracked = {"object_id": "a", "name": "<b>x</b>", "created_at": "then", "sessions": ["s"]}
    passes = [{"pass": k, "start": "from", "end": "to", "sessions": ["s"]} for k in range(5)]
    known = ObjectFacts(tracked, passes, spin(), "", [], None, "no frame", "1", "now")
    page = object_html(known).decode()
    assert "<b>x</b>" not in page
    periods = page[page.index("<svg") : page.index("</svg>")]
    assert periods.count("<circle") == 5 and periods.count("<polyline") == 1
    assert len(re.findall(r'<line x1="[^"]+" x2="[^"]+" y1="[^"]+" y2="[^"]+" stroke="#1c232b"/>', periods)) == 5
    assert page.count("not counted") == 1 and page.count("1080.250") == 3
    right_ascension = page[page.index("Right ascension of the axis") :]
    heights = re.findall(r'text-anchor="end">([^<]+)<', right_ascension[: right_ascension.index("</svg>")])
    assert max(abs(float(one)) for one in heights) < 1.0  # 359.9 and 0.1 degrees are neighbours
    assert "In its last pass: how it turned is not known: no frame." in page
