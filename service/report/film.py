"""The pictures of a report: cut around the object, in a sheet and as a film."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

RGB = NDArray[np.uint8]
_SIDE_PX = 256  # of a picture in a report
_QUALITY = 85  # of WebP: an outline one pixel wide stays sharp
_FILM_S = 6.0  # numerical taste: how long the film takes, however long the pass
_SLOWEST_MS = 400


@dataclass(frozen=True)
class Shot:
    """What was drawn of a frame: PNG files by what they show (``workers.base.Shown``)."""

    index: int
    x_px: float  # of the object's centre
    y_px: float
    pictures: Mapping[str, bytes]


@dataclass(frozen=True)
class Still:
    """A frame's pictures as data URIs."""

    index: int
    pictures: Mapping[str, str]


def stills(shots: Sequence[Shot], span_px: float) -> list[Still]:
    """Each picture cut around the object; ``span_px``: side of the square that is shown, the same in all."""
    return [
        Still(shot.index, {name: _uri(_cut(_decoded(png), shot, span_px)) for name, png in shot.pictures.items()})
        for shot in shots
    ]


def film(shots: Sequence[Shot], span_px: float) -> str | None:
    """All pictures side by side, frame after frame, as the data URI of an animated WebP; None of no frame.

    ``shots`` all have the same pictures.
    """
    if not shots:
        return None
    rows = [np.hstack([_cut(_decoded(png), shot, span_px) for png in shot.pictures.values()]) for shot in shots]
    moving = cv2.Animation()
    moving.frames = [np.ascontiguousarray(row[:, :, ::-1]) for row in rows]
    moving.durations = [min(_SLOWEST_MS, round(1000 * _FILM_S / len(rows)))] * len(rows)
    done, data = cv2.imencodeanimation(".webp", moving, [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])
    assert done, "OpenCV's wheels bring WebP"
    return _data_uri(data)


def _cut(picture: RGB, shot: Shot, span_px: float) -> RGB:
    """(S, S, 3) around the object; what lies outside of the frame is grey."""
    half = span_px / 2
    scale = _SIDE_PX / span_px
    to_cut = np.array([[scale, 0, scale * (half - shot.x_px)], [0, scale, scale * (half - shot.y_px)]])
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC if scale < 2 else cv2.INTER_NEAREST
    cut = cv2.warpAffine(picture, to_cut, (_SIDE_PX, _SIDE_PX), flags=way, borderValue=(60, 60, 60))
    return np.asarray(cut, np.uint8)


def _decoded(png: bytes) -> RGB:
    found = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert found is not None, "a picture that this service drew"
    return np.asarray(found[:, :, ::-1], np.uint8)


def _uri(picture: RGB) -> str:
    done, data = cv2.imencode(".webp", np.ascontiguousarray(picture[:, :, ::-1]), [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])
    assert done, "OpenCV's wheels bring WebP"
    return _data_uri(data)


def _data_uri(data: NDArray[np.uint8]) -> str:
    return "data:image/webp;base64," + base64.b64encode(data.tobytes()).decode()
