"""Line charts with bands, as SVG inside a page: no script, and as sharp on paper as on screen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup, escape

from service.inference.state import Array

_WIDTH, _HEIGHT = 720, 190
_LEFT, _RIGHT, _TOP, _BOTTOM = 52, 8, 8, 22
_TICKS = 5


@dataclass(frozen=True)
class Line:
    """One curve."""

    name: str
    colour: str
    values: Array  # (N,) NaN where nothing is known
    sigma: Array | None = None  # (N,) half-width of its band


@dataclass(frozen=True)
class _Scale:
    """Data to places in the picture."""

    first: float
    last: float
    low: float
    high: float

    def x(self, seconds: Array) -> Array:
        share = (seconds - self.first) / ((self.last - self.first) or 1.0)
        return np.asarray(_LEFT + share * (_WIDTH - _LEFT - _RIGHT))

    def y(self, values: Array) -> Array:
        share = (np.clip(values, self.low, self.high) - self.low) / (self.high - self.low)
        return np.asarray(_HEIGHT - _BOTTOM - share * (_HEIGHT - _TOP - _BOTTOM))


def chart(
    says: str, seconds: Array, lines: Sequence[Line], limits: tuple[float, float] | None = None, wraps: float = np.inf
) -> Markup:
    """One chart; ``says`` is read aloud. A curve breaks where it jumps by more than half of ``wraps``."""
    low, high = limits or _limits(lines)
    scale = _Scale(float(seconds[0]), float(seconds[-1]), low, high)
    parts = [_grid(scale)]
    for line in lines:
        parts.extend(_piece(scale, seconds[piece], line, piece) for piece in _pieces(line.values, wraps))
    head = f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img" aria-label="{escape(says)}">'
    return Markup(head + "".join(parts) + "</svg>")


def ticks(low: float, high: float) -> list[float]:
    """Round numbers (1, 2, 5 times a power of ten) between two ends."""
    rough = (high - low) / _TICKS
    power = 10.0 ** np.floor(np.log10(rough))
    step = next(size for size in (power, 2 * power, 5 * power, 10 * power) if size >= rough)
    return [float(step * k) for k in range(int(np.ceil(low / step)), int(np.floor(high / step + 1e-9)) + 1)]


def _limits(lines: Sequence[Line]) -> tuple[float, float]:
    """From the least to the greatest of all curves with their bands, and a little more."""
    ends = [line.values + side * (0.0 if line.sigma is None else line.sigma) for line in lines for side in (-1, 1)]
    known = np.concatenate(ends)[np.isfinite(np.concatenate(ends))]
    if not known.size:
        return 0.0, 1.0
    low, high = float(known.min()), float(known.max())
    margin = 0.05 * (high - low) or 0.5
    return low - margin, high + margin


def _pieces(values: Array, wraps: float) -> Iterator[slice]:
    """Stretches without a gap and without a jump."""
    known = np.isfinite(values)
    jumps = np.abs(np.diff(values, prepend=values[:1])) > wraps / 2
    first = None
    for k in range(len(values) + 1):
        ends = k == len(values) or not known[k] or jumps[k]
        if first is not None and ends:
            yield slice(first, k)
            first = None
        if k < len(values) and known[k] and first is None:
            first = k


def _piece(scale: _Scale, seconds: Array, line: Line, piece: slice) -> str:
    x, values = scale.x(seconds), line.values[piece]
    out = ""
    if line.sigma is not None and len(x) > 1:
        above, below = scale.y(values + line.sigma[piece]), scale.y(values - line.sigma[piece])
        around = _points(np.concatenate([x, x[::-1]]), np.concatenate([above, below[::-1]]))
        out = f'<polygon points="{around}" fill="{line.colour}" opacity=".22"/>'
    if len(x) == 1:
        if line.sigma is not None:
            ends = scale.y(values + np.array([-1.0, 1.0]) * line.sigma[piece])
            places = f'x1="{x[0]:.1f}" x2="{x[0]:.1f}" y1="{ends[0]:.1f}" y2="{ends[1]:.1f}"'
            out = f'<line {places} stroke="{line.colour}"/>'
        return out + f'<circle cx="{x[0]:.1f}" cy="{scale.y(values)[0]:.1f}" r="2" fill="{line.colour}"/>'
    return out + f'<polyline points="{_points(x, scale.y(values))}" fill="none" stroke="{line.colour}"/>'


def _points(x: Array, y: Array) -> str:
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))


def _grid(scale: _Scale) -> str:
    bottom, right = _HEIGHT - _BOTTOM, _WIDTH - _RIGHT
    out = []
    for value in ticks(scale.low, scale.high):
        y = float(scale.y(np.array(value)))
        out.append(f'<line class="grid" x1="{_LEFT}" x2="{right}" y1="{y:.1f}" y2="{y:.1f}"/>')
        out.append(f'<text x="{_LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{value:g}</text>')
    if scale.last > scale.first:
        for value in ticks(scale.first, scale.last):
            x = float(scale.x(np.array(value)))
            out.append(f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="{_TOP}" y2="{bottom}"/>')
            out.append(f'<text x="{x:.1f}" y="{bottom + 15}" text-anchor="middle">{value:g}</text>')
    return "".join(out)
