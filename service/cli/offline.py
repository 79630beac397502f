"""One pass through a service of this process, with its answers written to files."""

from __future__ import annotations

import csv
import io
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from service.api.schemas import Estimate, Pose, Session
from service.cli.images import ImageSource
from service.cli.ingest_session import SessionPlan, begin_session
from service.cli.model_file import ModelFile
from service.client import Client, RefusedError
from service.imaging.contact_sheet import SHOWN_FRAMES, SheetRow, contact_sheet
from service.imaging.decode import decode_frame
from service.imaging.overlay import encode_png
from service.inference.articulation import hold
from service.inference.state import Poses
from service.remote.calls import get_bytes
from service.remote.options import FrameFacts
from service.report.page import counted
from service.simulate.compare import silhouette

_CONFLICT = 409


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
class OfflinePass:
    """A session's plan, the frames it is fed, and where its answers go."""

    model: ModelFile
    plan: SessionPlan  # without a mesh the model is the bundled one
    frames: ImageSource
    out: Path
    start: datetime | None = None  # of the first frame, where the files do not tell
    smoothed: bool = False

    def run(self, client: Client, console: Console) -> PassSummary:
        """Begin the session, track every frame, write the answers. Raises ``ClientError``, ``ImageError``."""
        self.out.mkdir(parents=True, exist_ok=True)
        session = self._begin(client)
        for warning in session.warnings:
            console.print(f"[yellow]{warning}[/yellow]")
        names: list[str] = []
        statuses: list[str] = []
        warnings: list[str] = []
        rows: dict[int, SheetRow] = {}
        began = time.perf_counter()
        with _progress(console) as progress, (self.out / "estimates.jsonl").open("w") as lines:
            task = progress.add_task("tracking", total=self.frames.count, status="")
            for name, estimate in self._track(client, session):
                lines.write(estimate.model_dump_json(exclude_unset=True) + "\n")
                names.append(name)
                statuses.append(estimate.status)
                warnings += estimate.warnings
                if estimate.index + 1 in SHOWN_FRAMES:
                    rows[estimate.index] = self._sheet_row(client, session, estimate)
                progress.update(task, advance=1, status=estimate.status)
        seconds = time.perf_counter() - began
        for warning in counted(warnings):
            console.print(f"[yellow]{warning}[/yellow]")
        if len(names) - 1 not in rows:
            rows[len(names) - 1] = self._sheet_row(client, session, client.estimate(session.session_id))
        sheet = contact_sheet(f"{self.model.name}: {self.frames.path}", list(rows.values()))
        (self.out / "contact_sheet.png").write_bytes(encode_png(sheet))
        self._export(client, session, names, console)
        return PassSummary({name: statuses.count(name) for name in dict.fromkeys(statuses)}, seconds, self.out)

    def _begin(self, client: Client) -> Session:
        first = next(iter(self.frames))
        with tempfile.TemporaryDirectory(prefix="skypose-") as folder:
            path = Path(folder) / first.name.replace("#", "_")
            path = path if first.media_type != "image/png" else path.with_suffix(".png")
            path.write_bytes(first.body)
            mesh = self.plan.mesh or Path(folder) / self.model.name
            if self.plan.mesh is None:
                mesh.write_bytes(self.model.data)
            return begin_session(client, replace(self.plan, mesh=mesh), path)

    def _track(self, client: Client, session: Session) -> Iterator[tuple[str, Estimate]]:
        """Every frame's name and estimate."""
        step, index = timedelta(seconds=session.motion["frame_interval_s"]), 0
        for file in self.frames.files_to_post():
            facts: FrameFacts = {} if self.start is None else {"time": self.start + index * step}
            answers = client.track_file(session.session_id, file.body, file.media_type, index=index, **facts)
            for k, estimate in enumerate(answers):
                yield f"{file.name}#{k}" if file.several else file.name, estimate
                index += 1

    def _export(self, client: Client, session: Session, names: Sequence[str], console: Console) -> None:
        """The table that the service exports, with the files' names; motion and attitudes, where they are known."""
        text = client.export(session.session_id, "csv", smoothed=self.smoothed).decode()
        with (self.out / "estimates.csv").open("w", newline="") as file:
            table = csv.writer(file)
            for row, name in zip(csv.reader(io.StringIO(text)), ["name", *names], strict=True):
                table.writerow([*row, name])
        try:
            motion = client.motion(session.session_id)
        except RefusedError as error:
            if error.status != _CONFLICT:
                raise
            console.print(f"no motion.json: {error.detail}")
        else:
            (self.out / "motion.json").write_text(motion.model_dump_json(indent=2) + "\n")
        (self.out / "report.html").write_bytes(client.report(session.session_id))
        try:
            attitudes = client.export(session.session_id, "aem", smoothed=self.smoothed)
        except RefusedError as error:
            if error.status != _CONFLICT:
                raise
            console.print(f"no attitude.aem: {error.detail}")
        else:
            (self.out / "attitude.aem").write_bytes(attitudes)

    def _sheet_row(self, client: Client, session: Session, estimate: Estimate) -> SheetRow:
        path = f"/v1/sessions/{session.session_id}/estimates/{estimate.index}/frame.png"
        pixels = decode_frame(client.call(get_bytes(path)), "image/png").image
        held = hold(self.model.articulation, tuple(session.joints["free"]), session.joints["fixed"])
        pose = as_poses(estimate.best, tuple(joint.name for joint in held.joints))
        label = f"frame {estimate.index + 1}\n{estimate.status}\nspread {estimate.spread.orientation_deg:.1f} deg"
        return SheetRow(label, pixels, silhouette(self.model.mesh, held, pose, (pixels.shape[1], pixels.shape[0])))


def as_poses(pose: Pose, joints: Sequence[str]) -> Poses:
    """One pose of the wire as a batch of one, with the ``joints`` in this order."""
    q = pose.orientation
    return Poses(
        np.array([[q.w, q.x, q.y, q.z]]),
        np.array([[pose.x_px, pose.y_px]]),
        np.log([pose.scale_px]),
        np.array([[pose.joints[name] for name in joints]], dtype=np.float64),
    )


def _progress(console: Console) -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, TextColumn("{task.fields[status]}"), console=console)
