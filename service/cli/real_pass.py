"""One real sequence through a service of this process: its figures, and its part of a page of pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from gpu.lens import NO_LENS
from service.api.schemas import Estimate
from service.bench.real import RealSequence
from service.bench.silhouette import overlap
from service.cli.images import ImageSource
from service.cli.ingest_session import SessionPlan
from service.cli.model_file import read_model_file
from service.cli.offline import OfflinePass, as_poses
from service.client import Client, RefusedError
from service.inference.articulation import hold
from service.remote.calls import get_bytes
from service.simulate.compare import silhouette

PICTURES = ("frame", "overlay", "model", "residual")
_SHOWN = 4  # frames of each sequence on the page: the first, the last and two between


@dataclass(frozen=True)
class SkyFrom:
    """Where a background is known from in frame 1: outside of a box ``x,y,w,h``, or a margin, px; neither: itself."""

    box: str | None = None
    border: float | None = None


@dataclass(frozen=True)
class RealRow:
    """How a sequence went."""

    name: str
    frames: int
    statuses: dict[str, int]
    overlap: float | None  # median intersection over union with the truth; None: none is known
    least_tracking: float | None  # the least of frames told as tracking
    ms: float  # of a frame, median


def follow(
    client: Client, sequence: RealSequence, out: Path, limit: int | None, sky: SkyFrom, console: Console
) -> tuple[RealRow, str]:
    """One sequence: its row, and its part of the page."""
    model = read_model_file(str(sequence.mesh), sequence.joints)
    files = sequence.frames[:limit]
    config: dict[str, Any] = {"joints": {"free": list(sequence.free)}}
    if sequence.lens is not None:
        focal, *middle = sequence.lens
        config["camera"] = {"perspective": focal, "principal_point": middle}
    plan = SessionPlan(sequence.mesh, None, sky.box, sky.border, sequence.joints, config)
    source = ImageSource(files[0].parent, files, len(files), None)
    summary = OfflinePass(model, plan, source, out).run(client, console)
    told = [Estimate.model_validate_json(line) for line in (out / "estimates.jsonl").read_text().splitlines()]
    held = hold(model.articulation, sequence.free, {})
    met: dict[int, float] = {}
    for one in told:
        if one.index in sequence.truth:
            truth = sequence.truth[one.index](model.mesh, held)
            pose = as_poses(one.best, tuple(joint.name for joint in held.joints))
            met[one.index] = overlap(
                silhouette(model.mesh, held, pose, truth.shape[::-1], sequence.lens or NO_LENS), truth
            )
    sure = [met[one.index] for one in told if one.index in met and one.status == "tracking"]
    row = RealRow(
        name=sequence.name,
        frames=len(told),
        statuses=dict(summary.statuses),
        overlap=round(float(np.median(list(met.values()))), 3) if met else None,
        least_tracking=round(min(sure), 3) if sure else None,
        ms=round(float(np.median([one.timing_ms["total"] for one in told])), 1),
    )
    shown = sorted({round(share * (len(told) - 1)) for share in np.linspace(0, 1, _SHOWN)})
    strips = [_strip(client, told[k], met.get(told[k].index), out) for k in shown]
    return row, f"<h2>{escape(row.name)}</h2>\n<p>{escape(line_of(row))}</p>\n" + "\n".join(strips)


def _strip(client: Client, one: Estimate, met: float | None, out: Path) -> str:
    """A frame's pictures, as files beside the page; a picture that the service has not is left out, and said."""
    cells = [f"frame {one.index + 1}: {one.status}" + ("" if met is None else f", overlap {met:.2f}")]
    for name in PICTURES:
        try:
            image = client.call(get_bytes(f"/v1/sessions/{one.session_id}/estimates/{one.index}/{name}.png"))
        except RefusedError as error:
            cells.append(escape(error.detail))
            continue
        file = out / f"{one.index:03d}_{name}.png"
        file.write_bytes(image)
        cells.append(f'<img src="{out.name}/{file.name}" alt="{name}" title="{name}">')
    return "<div>" + "".join(f"<span>{cell}</span>" for cell in cells) + "</div>"


def line_of(row: RealRow) -> str:
    """For people."""
    shares = ", ".join(f"{count} {name}" for name, count in row.statuses.items())
    known = "no truth" if row.overlap is None else f"overlap {row.overlap:.2f}"
    least = "" if row.least_tracking is None else f", {row.least_tracking:.2f} at the least while tracking"
    return f"{row.name}: {row.frames} frames ({shares}), {known}{least}, {row.ms:.0f} ms"


def page_of(sections: Sequence[str]) -> str:
    """The sequences' parts as one HTML page; pictures lie beside it."""
    style = "body{font:15px sans-serif;background:#181818;color:#eee} div{display:flex;gap:6px;margin:6px 0}"
    style += " span{width:22%} img{width:100%;image-rendering:pixelated}"
    head = f'<meta charset="utf-8"><title>Real sequences</title><style>{style}</style>'
    return f'<!doctype html><html lang="en"><head>{head}</head><body>\n' + "\n".join(sections) + "\n</body></html>\n"
