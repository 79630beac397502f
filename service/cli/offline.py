"""One pass through the tracker in this process, with its answers written to files."""

from __future__ import annotations

import csv
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from service.cli.images import ImageFile, ImageSource
from service.cli.model_file import ModelFile
from service.imaging.contact_sheet import SHOWN_FRAMES, SheetRow, contact_sheet
from service.imaging.decode import decode_frame
from service.imaging.overlay import encode_png
from service.inference.articulation import hold
from service.inference.params import SessionConfig
from service.inference.state import FilterState, PoseEstimate, Poses
from service.sessions.document import JointNames, estimate_document
from service.sessions.frame import format_time, own_sky_frames
from service.sessions.lighting import light_at
from service.sessions.ranging import scale_bounds
from service.simulate.compare import silhouette
from service.workers.base import BackgroundJob, FrameJob, FrameReport, ModelJob, PackedFrameReport
from service.workers.tracker import Tracker, content_key

_SESSION_ID = "offline"
_COLUMNS = (
    *("frame", "time_s", "name", "status", "qx", "qy", "qz", "qw", "x_px", "y_px", "scale_px"),
    *("log_likelihood", "spread_orientation_deg", "modes", "ess", "log_evidence", "ms"),
)


@dataclass(frozen=True)
class PassSummary:
    """How a pass went."""

    statuses: Mapping[str, int]  # frames of each
    seconds: float
    out: Path

    @property
    def frames(self) -> int:
        """All frames."""
        return sum(self.statuses.values())

    @property
    def frames_per_s(self) -> float:
        """Decoding and tracking together."""
        return self.frames / self.seconds if self.seconds > 0 else 0.0

    def line(self) -> str:
        """For people."""
        shares = ", ".join(f"{count} {name}" for name, count in self.statuses.items())
        return f"{self.frames} frames ({shares}), {self.frames_per_s:.1f} per second: {self.out}"

    def document(self) -> dict[str, Any]:
        """For ``--json``."""
        head = {"frames": self.frames, "statuses": dict(self.statuses), "seconds": round(self.seconds, 3)}
        return {**head, "frames_per_s": round(self.frames_per_s, 2), "out": str(self.out)}


@dataclass(frozen=True)
class Sky:
    """Where the background is learned: empty images, or what the first frame shows outside a box or at its border.

    Where nothing is told: what lies around the object in the first frames.
    """

    images: ImageSource | None
    box: tuple[float, float, float, float] | None = None
    border_px: float | None = None

    @property
    def own(self) -> bool:
        """Whether nothing is told."""
        return self.images is None and self.box is None and self.border_px is None


class OfflinePass:
    """Tracks one model through images. Owns the tracker; a context manager."""

    def __init__(self, model: ModelFile, joints: tuple[Mapping[str, Any], ...] | None, config: SessionConfig) -> None:
        self._model, self._config = model, config
        self._tracker = Tracker()
        report = self._tracker.prepare_model(ModelJob(model.data, model.file_type, joints))
        self._articulation, self._twins = report.articulation, report.twins
        self._warnings = report.warnings
        self._blobs = {content_key(model.data): model.data}
        self._names = JointNames.of(report.articulation, config)
        self._lit = light_at(config, {})
        self._assumed: tuple[str, ...] = ()

    def __enter__(self) -> OfflinePass:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._tracker.close()

    def run(self, frames: ImageSource, sky: Sky, out: Path, interval_s: float | None, console: Console) -> PassSummary:
        """Learn the sky, track every frame, write the answers; returns how it went."""
        for warning in self._warnings:
            console.print(f"[yellow]{warning}[/yellow]")
        out.mkdir(parents=True, exist_ok=True)
        step_s = interval_s or frames.interval_s or self._config.motion.frame_interval_s
        background = self._learn(sky, frames)
        self._assumed = ("background",) if sky.own else ()
        started = datetime.now(UTC)
        statuses: list[str] = []
        rows: dict[int, tuple[ImageFile, FrameReport]] = {}
        began = time.perf_counter()
        with (
            _progress(console) as progress,
            (out / "estimates.csv").open("w", newline="") as table,
            (out / "estimates.jsonl").open("wb") as lines,
        ):
            task = progress.add_task("tracking", total=frames.count, status="")
            writer = csv.writer(table)
            writer.writerow([*_COLUMNS, *self._names.free])
            state: FilterState | None = None
            for k, image in enumerate(frames):
                report = self._track(background, state, k, k * step_s, image)
                state = report.state
                writer.writerow(_csv_row(k, k * step_s, image.name, report))
                lines.write(self._document(k, started + timedelta(seconds=k * step_s), report) + b"\n")
                statuses.append(report.estimate.status)
                rows[k] = (image, report)
                if k > 0 and k not in SHOWN_FRAMES:  # the frame before, number k from 1, is neither shown nor last
                    del rows[k - 1]
                progress.update(task, advance=1, status=report.estimate.status)
        seconds = time.perf_counter() - began
        sheet = [self._sheet_row(k, image, report) for k, (image, report) in sorted(rows.items())]
        title = f"{self._model.name}: {frames.path}"
        (out / "contact_sheet.png").write_bytes(encode_png(contact_sheet(title, sheet)))
        return PassSummary({name: statuses.count(name) for name in dict.fromkeys(statuses)}, seconds, out)

    def _learn(self, sky: Sky, frames: ImageSource) -> str:
        """Key of the learned background among the blobs."""
        learned: bytes | None = None
        images: Sequence[ImageFile] | ImageSource
        images = sky.images or (own_sky_frames(frames) if sky.own else [next(iter(frames))])
        for image in images:
            job = BackgroundJob(self._config, image.body, image.media_type, learned, sky.box, sky.border_px, sky.own)
            learned = self._tracker.learn_background(job).background
        assert learned is not None, "an image source has at least one image"
        key = content_key(learned)
        self._blobs[key] = learned
        return key

    def _track(
        self, background: str, state: FilterState | None, index: int, time_s: float, image: ImageFile
    ) -> FrameReport:
        return self._tracker.track(
            FrameJob(
                config=self._config,
                model=content_key(self._model.data),
                file_type=self._model.file_type,
                articulation=self._articulation,
                background=background,
                state=state,
                frame_index=index,
                time_s=time_s,
                body=image.body,
                media_type=image.media_type,
                twins=self._twins,
                blobs=self._blobs,
                scale_px=scale_bounds(self._config.prior, None),
                light=self._lit.light,
            )
        )

    def _document(self, index: int, moment: datetime, report: FrameReport) -> bytes:
        packed = PackedFrameReport(b"", report.estimate, report.timing_ms, report.scorer)
        return estimate_document(
            _SESSION_ID, index, format_time(moment), self._names, packed, lit=self._lit, assumed=self._assumed
        )

    def _sheet_row(self, index: int, image: ImageFile, report: FrameReport) -> SheetRow:
        pixels = decode_frame(image.body, image.media_type).image
        best, estimate = report.estimate.best, report.estimate
        held = hold(self._articulation, self._config.joints.free, self._config.joints.fixed)
        size = (pixels.shape[1], pixels.shape[0])
        label = f"frame {index + 1}\n{estimate.status}\nspread {estimate.spread.orientation_deg:.1f} deg"
        return SheetRow(label, pixels, silhouette(self._model.mesh, held, as_poses(best), size))


def as_poses(pose: PoseEstimate) -> Poses:
    """One reported pose as a batch of one."""
    return Poses(pose.quaternion[None], pose.position[None], np.log([pose.scale]), pose.joints[None])


def _csv_row(index: int, time_s: float, name: str, report: FrameReport) -> list[Any]:
    estimate = report.estimate
    w, x, y, z = (round(float(v), 8) for v in estimate.best.quaternion)
    place = [round(float(v), 4) for v in estimate.best.position]
    return [
        *(index, round(time_s, 6), name, estimate.status, x, y, z, w, *place, round(estimate.best.scale, 6)),
        *(round(estimate.best_log_likelihood, 3), round(estimate.spread.orientation_deg, 4), len(estimate.modes)),
        *(round(estimate.ess, 2), round(estimate.log_evidence, 3), round(report.timing_ms["total"], 3)),
        *(round(float(v), 4) for v in estimate.best.joints),
    ]


def _progress(console: Console) -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, TextColumn("{task.fields[status]}"), console=console)
