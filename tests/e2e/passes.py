"""Small passes for whole-service tests: with the fake worker any image will do, the tracker gets a real one."""

import io
from dataclasses import dataclass

import cv2
import httpx
import numpy as np
import trimesh

PNG = {"Content-Type": "image/png"}


@dataclass(frozen=True)
class Pass:
    """What a client posts."""

    mesh: bytes
    background: list[bytes]
    frames: list[bytes]


def fake_pass(n_frames: int) -> Pass:
    """Noise; enough for the fake worker."""
    return Pass(b"cube", [_png(_noise(0))], [_png(_noise(n + 1)) for n in range(n_frames)])


def box_pass(n_frames: int, size: int = 64) -> Pass:
    """A bright box that turns before a noisy sky."""
    box = trimesh.creation.box((2.0, 1.2, 0.6))
    frames = []
    for n in range(n_frames):
        turn = trimesh.transformations.euler_matrix(0.3, 0.5 + 0.03 * n, 0.2)[:3, :3]
        corners = (box.vertices @ turn.T)[:, :2] * size / 4 + size / 2
        pixels = _noise(n, size).astype(np.uint8)
        hull = cv2.convexHull(np.round(corners).astype(np.int32))
        cv2.fillConvexPoly(pixels, hull, 180)
        frames.append(_png(pixels))
    file = io.BytesIO()
    box.export(file, file_type="stl")
    return Pass(file.getvalue(), [_png(_noise(100 + n, size)) for n in range(3)], frames)


def _noise(seed: int, size: int = 16) -> np.ndarray:
    return np.random.default_rng(seed).normal(20, 3, (size, size)).clip(0, 255).astype(np.uint8)


def _png(pixels: np.ndarray) -> bytes:
    return cv2.imencode(".png", pixels)[1].tobytes()


def begin(http: httpx.Client, given: Pass, name: str = "body.stl", **session: object) -> str:
    """Upload, create, teach the background. Returns the session's id."""
    model = http.post("/v1/models", files={"file": (name, given.mesh)}).raise_for_status().json()
    body = {"model_id": model["model_id"], **session}
    session_id = http.post("/v1/sessions", json=body).raise_for_status().json()["session_id"]
    for image in given.background:
        http.post(f"/v1/sessions/{session_id}/background", content=image, headers=PNG).raise_for_status()
    return session_id


def comparable(estimate: dict) -> dict:
    """An estimate without what may differ between two runs: names, arrival, speed."""
    return {
        name: value for name, value in estimate.items() if name not in ("session_id", "time", "timing_ms", "duplicate")
    }


def history(http: httpx.Client, session_id: str) -> list[dict]:
    """All estimates, comparable."""
    found = http.get(f"/v1/sessions/{session_id}/estimates", params={"limit": 1000}).raise_for_status().json()
    assert found["next"] is None
    return [comparable(estimate) for estimate in found["estimates"]]
