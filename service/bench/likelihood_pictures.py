"""Contact sheets: the frame after its low pass, the model and what it leaves over, at the truth and elsewhere."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from service.bench.likelihood import LikelihoodRow, Looked
from service.simulate.folder import encode_png

RGB = NDArray[np.uint8]
ROWS = 12  # of a sheet
_SIDE, _LABEL, _GAP, _HEAD = 144, 150, 4, 22  # px
_COLUMNS = ("frame", "at the truth", "left over", "at the best other", "left over")
_PAPER, _INK, _LOST = 24, (230, 230, 230), (255, 110, 90)
_BRIGHT = 0.998  # quantile of the frame that is white
_FULL = 0.3  # of that: residuals of full colour


def contact_sheets(looked: Sequence[Looked]) -> Iterator[tuple[str, bytes]]:
    """File names and PNG files, the narrowest margin first; frames that show no other basin last."""
    ordered = sorted(looked, key=lambda one: np.inf if one.row.margin_nats is None else one.row.margin_nats)
    for k in range(0, len(ordered), ROWS):
        yield f"frames_{k // ROWS:02d}.png", encode_png(_sheet(ordered[k : k + ROWS]))


def _sheet(looked: Sequence[Looked]) -> RGB:
    width = _LABEL + len(_COLUMNS) * (_SIDE + _GAP)
    head = np.full((_HEAD, width, 3), _PAPER, np.uint8)
    for k, name in enumerate(_COLUMNS):
        _write(head, name, _LABEL + k * (_SIDE + _GAP), 15, _INK)
    return np.vstack([head, *(_strip(one) for one in looked)])


def _strip(one: Looked) -> RGB:
    out = np.full((_SIDE + _GAP, _LABEL + len(_COLUMNS) * (_SIDE + _GAP), 3), _PAPER, np.uint8)
    for k, line in enumerate(_label(one.row)):
        _write(out, line, 4, 16 + 17 * k, _INK if one.row.truth_wins else _LOST)
    views = one.views
    white = max(float(np.quantile(views.frame, _BRIGHT)), 1e-6)
    pictures = [_grey(views.frame, white), _grey(views.truth[0], white), _signed(views.truth[1], _FULL * white)]
    if views.other is not None:
        pictures += [_grey(views.other[0], white), _signed(views.other[1], _FULL * white)]
    for k, picture in enumerate(pictures):
        x = _LABEL + k * (_SIDE + _GAP)
        out[:_SIDE, x : x + _SIDE] = cv2.resize(picture, (_SIDE, _SIDE), interpolation=cv2.INTER_NEAREST)
    return out


def _label(row: LikelihoodRow) -> tuple[str, ...]:
    margin = "no other" if row.margin_nats is None else f"{row.margin_nats:+.1f} nats"
    twin = "" if row.twin_margin_nats is None else f"twin {row.twin_margin_nats:+.1f}"
    air = "turbulent" if row.turbulent else ""
    found = "nothing found" if row.found_err_deg is None else f"found {row.found_err_deg:.1f} deg"
    return f"{row.case} {row.frame}", margin, twin, found, air


def _grey(image: NDArray[np.float32], white: float) -> RGB:
    """By its square root: dark panels beside bright metal."""
    grey = (255 * np.sqrt(np.clip(image / white, 0, 1))).astype(np.uint8)
    return np.repeat(grey[:, :, None], 3, axis=2)


def _signed(image: NDArray[np.float32], full: float) -> RGB:
    """Red where the frame has more light than the model, blue where less."""
    share = np.clip(image / full, -1, 1)
    more, less = np.maximum(share, 0), np.maximum(-share, 0)
    return np.asarray(255 * np.stack([more, 0.35 * (more + less), less], axis=-1), np.uint8)


def _write(picture: RGB, text: str, x: int, y: int, ink: tuple[int, int, int]) -> None:
    cv2.putText(picture, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.42, ink, 1, cv2.LINE_AA)
