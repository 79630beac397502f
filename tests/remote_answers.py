"""Documents as the service answers them, for tests of its clients."""


def pose() -> dict:
    turn = {"orientation": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}, "yaw_deg": 0.0, "pitch_deg": 0.0, "roll_deg": 0.0}
    return {**turn, "x_px": 1.0, "y_px": 2.0, "scale_px": 3.0, "joints": {}, "attitude": None, "of_a_newer_service": 1}


def estimate(index: int) -> dict:
    spread = dict.fromkeys(("orientation_deg", "yaw_deg", "pitch_deg", "roll_deg", "x_px", "y_px", "scale_px"), 0.0)
    spread = {**spread, "joints": {}, "covariance": [[1.0]], "covariance_order": ["rx_deg"]}
    head = {"session_id": "s", "index": index, "time": "2026-11-20T03:04:05.000Z", "status": "tracking"}
    middle = {"duplicate": False, "mean": pose(), "best": {**pose(), "log_likelihood": -1.0}, "spread": spread}
    tail = {"modes": [], "particles": 10, "ess": 5.0, "log_evidence": -2.0, "timing_ms": {}, "scorer": "fake"}
    return {**head, **middle, **tail}
