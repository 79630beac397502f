"""The demo's client: posts the simulated pass over REST and holds the answers against the truth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from service.cli.demo_service import DemoError
from service.cli.model_file import ModelFile
from service.imaging.contact_sheet import SheetRow, contact_sheet, shown_indices
from service.imaging.overlay import encode_png
from service.inference.state import Poses
from service.simulate.camera import Image
from service.simulate.compare import PoseErrors, compare, silhouette
from service.simulate.folder import encode_png as encode_frame
from service.simulate.sequence import SimulatedPass

_TIMEOUT_S = 120.0
SETTLED_FRAME = 10
WITHIN_DEG = 5.0
LEAST_WITHIN = 0.8
LEAST_IOU = 0.85


@dataclass(frozen=True)
class FrameResult:
    """A frame's answer and how far its best pose is from the truth."""

    index: int
    answer: Mapping[str, Any]
    errors: PoseErrors


@dataclass(frozen=True)
class Verdict:
    """Whether the track held: the settled part of the pass within 5 degrees, and overlapping."""

    within_share: float
    median_iou: float
    median_error_deg: float

    @property
    def held(self) -> bool:
        """Both figures reach what the demo asks for."""
        return self.within_share >= LEAST_WITHIN and self.median_iou >= LEAST_IOU


class DemoPass:
    """One session of a running service that is fed a simulated pass."""

    def __init__(self, url: str, model: ModelFile, simulated: SimulatedPass) -> None:
        self._client = httpx.Client(base_url=f"{url}/v1", timeout=_TIMEOUT_S)
        self._model, self._simulated = model, simulated
        self._frames: list[Image] = []
        self._session = ""

    def open(self) -> str:
        """Upload the model, open a session, teach it the sky; returns the session's id."""
        uploaded = self._call("POST", "/models", files={"file": (self._model.name, self._model.data)})
        request = {"model_id": uploaded["model_id"], "name": "demo", "joints": {"free": "all"}}
        self._session = str(self._call("POST", "/sessions", json=request)["session_id"])
        for image in self._simulated.backgrounds():
            self._post_image("background", image)
        return self._session

    def track(self) -> Iterator[FrameResult]:
        """Post every frame; yields each answer against the truth."""
        for index, image in enumerate(self._simulated.frames()):
            self._frames.append(image)
            answer = self._post_image("frames", image)
            yield FrameResult(index, answer, self._errors(index, answer))

    def write_sheet(self, results: Sequence[FrameResult], path: Path) -> None:
        """Frame, best silhouette, overlay at the paper's frames."""
        rows = []
        for k in shown_indices(len(results)):
            result, pose = results[k], self._pose(results[k].answer["best"])
            mask = silhouette(self._model.mesh, self._model.articulation, pose, self._simulated.scenario.size)
            label = f"frame {k + 1}\nerror {result.errors.orientation_deg:.1f} deg\nIoU {result.errors.iou:.3f}"
            rows.append(SheetRow(label, self._frames[k], mask))
        path.write_bytes(encode_png(contact_sheet("skypose demo", rows)))

    def close(self) -> None:
        """Let the connection go; the session stays, for the viewer."""
        self._client.close()

    def _errors(self, index: int, answer: Mapping[str, Any]) -> PoseErrors:
        # The bundled satellite has no mirror plane, so its silhouette has no twin to allow for.
        truth = self._simulated.track.poses[index : index + 1]
        found = self._pose(answer["best"])
        return compare(self._model.mesh, self._model.articulation, truth, found, self._simulated.scenario.size)

    def _pose(self, pose: Mapping[str, Any]) -> Poses:
        q = pose["orientation"]
        joints = [pose["joints"][joint.name] for joint in self._model.articulation.joints]
        return Poses(
            np.array([[q["w"], q["x"], q["y"], q["z"]]]),
            np.array([[pose["x_px"], pose["y_px"]]]),
            np.log([pose["scale_px"]]),
            np.array([joints], dtype=np.float64),
        )

    def _post_image(self, kind: str, image: Image) -> Mapping[str, Any]:
        path = f"/sessions/{self._session}/{kind}"
        return self._call("POST", path, content=encode_frame(image), headers={"Content-Type": "image/png"})

    def _call(self, method: str, path: str, **request: Any) -> Mapping[str, Any]:
        try:
            response = self._client.request(method, path, **request)
        except httpx.TransportError as error:
            raise DemoError(f"{method} /v1{path}: {type(error).__name__}: {error}") from error
        if response.is_error:
            raise DemoError(f"{method} /v1{path}: {response.status_code} {response.text}")
        answer: Mapping[str, Any] = response.json()
        return answer


def judge(results: Sequence[FrameResult]) -> Verdict:
    """Over the frames from ``SETTLED_FRAME`` on."""
    settled = [result.errors for result in results[SETTLED_FRAME:]] or [result.errors for result in results]
    angles = np.array([errors.orientation_deg for errors in settled])
    return Verdict(
        float(np.mean(angles < WITHIN_DEG)),
        float(np.median([errors.iou for errors in settled])),
        float(np.median(angles)),
    )
