"""The answer in two sentences says what is known, and no more."""

import pytest

from service.report.sentences import attitude_sentence, told_probability, turning_sentence, with_sigma

MOTION = {
    "model": "constant_rate",
    "relative_to": "GCRF",
    "rate_deg_s": 5.0214,
    "rate_sigma_deg_s": 0.0132,
    "period_s": 71.69,
    "period_sigma_s": 0.19,
    "axis_gcrf": {"x": 0.0, "y": 1.0, "z": 1.0},
    "axis_gcrf_sigma_deg": 0.31,
    "axis_body": {"x": 0.0, "y": 0.0, "z": 1.0},
    "probability": 0.98,
    "attitude_mode": None,
}
FRAMES = [{"status": "tracking", "spread": {"orientation_deg": 0.51}}] * 3 + [
    {"status": "no_fit", "spread": {"orientation_deg": 40.0}}
]
MODE = {
    "mode": "nadir_pointing",
    "probabilities": {"nadir_pointing": 0.995, "tumbling": 0.005},
    "offset_deg": 3.12,
    "sigma_deg": 0.41,
    "body_axis": "+z",
}


@pytest.mark.parametrize(
    ("value", "sigma", "told"),
    [(5.0214, 0.0132, "5.021 ± 0.013"), (71.2, 11.3, "71 ± 11"), (0.0, 0.0, "0.000000 ± 0.000000")],
)
def test_two_digits_of_the_sigma(value, sigma, told):
    assert with_sigma(value, sigma) == told


@pytest.mark.parametrize(("value", "told"), [(1.0, "> 0.99"), (0.0, "< 0.01"), (0.5, "0.50")])
def test_nothing_is_certain(value, told):
    assert told_probability(value) == told


def test_a_turning_body():
    assert turning_sentence(MOTION, "") == (
        "It turned at 5.021 ± 0.013 °/s, once in 71.69 ± 0.19 s, about right ascension 90.0°, declination +45.0° "
        "(± 0.3°)."
    )


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"model": "tumbling"}, "It tumbled"),
        ({"period_s": None}, "No turning is seen: 5.021 ± 0.013 °/s."),
        ({"probability": 0.59}, "has a probability of 0.59 only"),
        ({"axis_gcrf": None, "relative_to": "camera"}, "against the camera"),
    ],
)
def test_what_else_is_said_of_the_motion(change, says):
    assert says in turning_sentence({**MOTION, **change}, "")


def test_why_the_motion_is_not_known():
    assert turning_sentence(None, "too few frames") == "How it turned is not known: too few frames."


def test_the_attitude_mode():
    told = attitude_sentence({**MOTION, "attitude_mode": MODE}, FRAMES)
    assert told == "It was nadir-pointing (p > 0.99), +z 3.12 ± 0.41° off; 3 of 4 frames are tracked."


def test_an_undecided_mode_is_no_answer():
    doubted = {**MODE, "probabilities": {"nadir_pointing": 0.6, "tumbling": 0.4}}
    assert attitude_sentence({**MOTION, "attitude_mode": doubted}, FRAMES).startswith(
        "Its attitude mode is not decided: nadir-pointing has a probability of 0.60"
    )


def test_without_a_mode_the_last_frame_is_told():
    assert attitude_sentence(None, FRAMES) == (
        "3 of 4 frames are tracked; in the last (no_fit) its orientation is stated to 40°."
    )
