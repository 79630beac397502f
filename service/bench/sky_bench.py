"""What learning a sky costs by the size of the image, and how well the sky is told."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.box import MARKDOWN
from rich.table import Table

from service.imaging.background import Background, learn
from service.imaging.features import FeatureSpec, feature_spec
from service.imaging.own_sky import own_sky
from service.imaging.sky import derive

_BITS, _FEATURE, _GRADIENT_PX = 16, "intensity", 1.0
_SIGMA, _LIGHT, _RADIUS_PX = 5.0, 900.0, 50.0  # counts of noise, counts of a body, its radius
_RIM = 0.1  # of a side, where a smooth sky is told from one side alone


@dataclass(frozen=True)
class SkyRow:
    """Of square images; medians of the repeats. Errors are in units of one pixel's noise."""

    side_px: int
    frames: int  # empty ones; 0: one that shows the body, whose sky is its own
    learn_ms: float  # of one frame, decoded
    derive_ms: float  # of all of them, once a worker
    level_error: float  # the largest in the middle of the image
    noise_error: float


def bench_sky(
    sides: Sequence[int], frames: Sequence[int], repeats: int, progress: Callable[[str], None] = lambda line: None
) -> list[SkyRow]:
    """A row for every side and number of frames."""
    rows = []
    for side in sides:
        for count in frames:
            rows.append(_row(side, count, repeats))
            progress(f"{side} px, {count} empty frames: derived in {rows[-1].derive_ms:.0f} ms")
    return rows


def _row(side: int, count: int, repeats: int) -> SkyRow:
    level, images = _images(side, max(count, 1), body=count == 0)
    spec = feature_spec(_FEATURE, 1, _BITS, _GRADIENT_PX)
    learn_ms, derive_ms, found = [], [], None
    for _ in range(repeats):
        learned: Background | None = None
        began = time.perf_counter()
        for image in images:
            learned = _learned(learned, image, spec, own=count == 0)
        middle = time.perf_counter()
        assert learned is not None, "there is an image at least"
        found = derive(learned, _FEATURE, _GRADIENT_PX)
        learn_ms.append(1e3 * (middle - began) / len(images))
        derive_ms.append(1e3 * (time.perf_counter() - middle))
    assert found is not None, "there is a repeat at least"
    rim = round(_RIM * side)
    off = np.abs(found.mean[..., 0] - level)[rim : side - rim, rim : side - rim]
    noise = float(found.sigma[0]) / _SIGMA - 1
    return SkyRow(side, count, median(learn_ms), median(derive_ms), float(off.max()) / _SIGMA, noise)


def _learned(learned: Background | None, image: NDArray[np.uint16], spec: FeatureSpec, own: bool) -> Background:
    shown, known = own_sky(image, _BITS) if own else (image, np.ones(image.shape, np.bool_))
    return learn(learned, shown, _BITS, spec, known)


def _images(side: int, count: int, body: bool) -> tuple[NDArray[np.float32], list[NDArray[np.uint16]]]:
    """The level of a sky that slopes, and images of it."""
    across, down = np.meshgrid(*2 * [np.linspace(-1, 1, side, dtype=np.float32)])
    level = 400 + 60 * across - 25 * down + 30 * across * down
    away = np.hypot(across, down) * 0.5 * side
    light = body * _LIGHT / (1 + np.exp(np.clip(away - _RADIUS_PX, -50, 50)))
    rng = np.random.default_rng(side)
    shape = (side, side)
    noisy = (level + light + _SIGMA * rng.standard_normal(shape, np.float32) for _ in range(count))
    return level, [np.rint(image).astype(np.uint16) for image in noisy]


def sky_document(machine: Mapping[str, Any], rows: Sequence[SkyRow]) -> dict[str, Any]:
    """The JSON."""
    found = [{k: round(v, 3) if isinstance(v, float) else v for k, v in asdict(row).items()} for row in rows]
    return {"machine": dict(machine), "rows": found, "absent": {}}


def sky_table(rows: Sequence[SkyRow]) -> Table:
    """A row for every size and number of frames."""
    table = Table("side px", "empty frames", "learn ms", "derive ms", "level error", "noise error", box=MARKDOWN)
    for row in rows:
        errors = f"{row.level_error:.2f}", f"{100 * row.noise_error:+.1f} %"
        table.add_row(str(row.side_px), str(row.frames), f"{row.learn_ms:.1f}", f"{row.derive_ms:.0f}", *errors)
    return table
