"""A report of a pass that is longer than a chart is wide."""

from datetime import UTC, datetime, timedelta

from service.report.page import Facts, counted, report_html

START = datetime(2026, 11, 20, 3, 4, 5, tzinfo=UTC)
POSE = {"orientation": dict.fromkeys("wxyz", 0.5), "x_px": 1.0, "y_px": 2.0, "scale_px": 3.0, "joints": {}}
SPREAD = {"orientation_deg": 0.5, "joints": {}, "covariance": [[0.1] * 6 for _ in range(6)]}


def estimate(k: int) -> dict:
    return {
        "time": (START + timedelta(seconds=k)).isoformat(),
        "status": "tracking",
        "best": POSE,
        "spread": SPREAD,
        "modes": [{"weight": 1.0, "pose": POSE, "spread": SPREAD}],
        "light": {"phase_deg": None, "sunlit": None, "source": "unknown"},
        "scorer": "light",
        "warnings": [],
        "assumed": ["time"],
    }


def test_every_frame_counts_and_a_curve_has_no_more_points_than_can_be_seen():
    sections = ("filter", "likelihood", "prior", "motion", "camera", "joints", "light", "background")
    session = {"session_id": "a", "name": None, "created_at": "then", "warnings": [], **dict.fromkeys(sections)}
    facts = Facts(
        session=session,
        models=[{"name": "body", "faces": 12, "parts": ["a"], "model_id": "m"}],
        estimates=[estimate(k) for k in range(5000)],
        motion=None,
        why_no_motion="the frames say nothing of it",
        shots=[],
        why_no_pictures="",
        span_px=100.0,
        system={"version": "1", "worker": {}},
        made_at="now",
    )
    page = report_html(facts).decode()
    assert "5000 tracking" in page
    assert "(5000 frames)" in page
    assert len(page) < 300_000


def test_warnings_that_differ_in_numbers_are_told_once():
    texts = ["the body is 9% smaller", "the camera points 3.0° away", "the body is 12.5% smaller"]
    assert counted(texts) == ["the body is 9% smaller (2 frames)", "the camera points 3.0° away"]
