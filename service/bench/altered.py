"""Passes as programs leave them before anybody posts them: compressed, denoised, sharpened, with a clock, and so on.

Compression and denoising know eight bits alone; images of sixteen stay as they are there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from numpy.typing import NDArray

from service.bench.brightness import counts, pixels, to_power
from service.bench.cases import Case, TruthFrame
from service.bench.folder import SequenceError
from service.imaging.decode import Pixels
from service.imaging.own_sky import OF_A_NORMAL
from service.simulate.folder import encode_png

_JPEG_QUALITY = 30
_DENOISED = 10.0  # strength of the non-local means: noise of three counts is gone
_SHARPENED, _SHARPENED_PX = 1.5, 2.0  # unsharp mask: how much, and of what is finer than this
_BLACK = 2.0  # black point: so many of its noise above the sky
_FULL, _LIT = 0.5, 6.0  # share of what is lit, so many of its noise above the sky, at which a sensor is full
_POWER = 0.45  # of light, as videos have it
_GAIN = 2.0  # of the later half
_STEP = 4  # counts of eight bits, 16 times as many of sixteen
_BARS, _SHAKEN = 0.15, 0.05  # of the height, of the shorter side: black bars, and how far a window moves
_CODEC, _PER_S = "mp4v", 25.0


def altered(case: Case, how: str) -> Case:
    """The case with its images changed, one of ``ALTERATIONS``. Raises ``SequenceError`` where OpenCV cannot."""

    def images() -> tuple[list[Pixels], list[TruthFrame]]:
        empty, seen = [pixels(body) for body in case.backgrounds()], list(case.frames())
        return ALTERATIONS[how]([*empty, *(pixels(body) for body, _ in seen)]), [truth for _, truth in seen]

    def backgrounds() -> Iterator[bytes]:
        changed, truths = images()
        yield from map(encode_png, changed[: len(changed) - len(truths)])

    def frames() -> Iterator[tuple[bytes, TruthFrame]]:
        changed, truths = images()
        yield from zip(map(encode_png, changed[len(changed) - len(truths) :]), truths, strict=True)

    return replace(case, backgrounds=backgrounds, frames=frames)


def _jpeg(images: Sequence[Pixels]) -> list[Pixels]:
    return [_compressed(image) if image.dtype == np.uint8 else image for image in images]


def _compressed(image: Pixels) -> Pixels:
    _, coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_UNCHANGED), np.uint8)


def _video(images: Sequence[Pixels]) -> list[Pixels]:
    if not images or images[0].dtype != np.uint8:
        return list(images)
    height, width = images[0].shape[:2]
    with TemporaryDirectory() as folder:
        path = str(Path(folder) / "pass.mp4")
        writer = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*_CODEC), _PER_S, (width, height))
        for image in images:
            writer.write(image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
        writer.release()
        reader = cv2.VideoCapture(path)
        read = [reader.read()[1] for _ in images]
        reader.release()
    if any(image is None for image in read):
        raise SequenceError(f"OpenCV has no codec {_CODEC}")
    return [
        np.asarray(one if like.ndim == 3 else one[..., 1], np.uint8) for one, like in zip(read, images, strict=True)
    ]


def _denoised(images: Sequence[Pixels]) -> list[Pixels]:
    return [
        np.asarray(cv2.fastNlMeansDenoising(image, None, _DENOISED), np.uint8) if image.dtype == np.uint8 else image
        for image in images
    ]


def _sharpened(images: Sequence[Pixels]) -> list[Pixels]:
    floats = [image.astype(np.float32) for image in images]
    finer = [image - cv2.GaussianBlur(image, (0, 0), _SHARPENED_PX) for image in floats]
    return [counts(one + _SHARPENED * more, like) for one, more, like in zip(floats, finer, images, strict=True)]


def _black(images: Sequence[Pixels]) -> list[Pixels]:
    level, noise = _sky_of(images[0])
    black = np.rint(level + _BLACK * noise)
    return [counts(image.astype(np.float32) - black, image) for image in images]


def _sky_of(empty: Pixels) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Level of an empty image and noise of its pixels, of each channel."""
    sky = empty.astype(np.float32)
    level = np.median(sky, axis=(0, 1))
    return level, OF_A_NORMAL * np.median(np.abs(sky - level), axis=(0, 1))


def _full(images: Sequence[Pixels]) -> list[Pixels]:
    """The sensor is full below what the file could hold, as one of twelve bits in a file of sixteen."""
    level, noise = _sky_of(images[0])
    least = level + _LIT * np.maximum(noise, 1.0)
    shown = np.stack(images[1:]).astype(np.float32)
    if not (shown > least).any():
        return list(images)
    most = np.nanquantile(np.where(shown > least, shown, np.nan), 1 - _FULL, axis=(0, 1, 2)).astype(np.float32)
    return [counts(np.minimum(image, most), image) for image in images]


def _gamma(images: Sequence[Pixels]) -> list[Pixels]:
    return [to_power(image, _POWER) for image in images]


def _gain(images: Sequence[Pixels]) -> list[Pixels]:
    """A camera that sets its gain, or its exposure, anew in the middle: light, sky and noise."""
    half = len(images) // 2
    return [*images[:half], *(counts(_GAIN * image.astype(np.float32), image) for image in images[half:])]


def _steps(images: Sequence[Pixels]) -> list[Pixels]:
    step = [_STEP if image.dtype == np.uint8 else 16 * _STEP for image in images]
    return [counts(one * np.rint(image / one), image) for one, image in zip(step, images, strict=True)]


def _bars(images: Sequence[Pixels]) -> list[Pixels]:
    bar = round(_BARS * images[0].shape[0])
    return [_window(image, bar, 0, 0, 0) for image in images]


def _stabilised(images: Sequence[Pixels]) -> list[Pixels]:
    far = round(_SHAKEN * min(images[0].shape[:2]))
    moves = np.random.default_rng(0).integers(-far, far + 1, (len(images), 2))
    return [_window(image, far + 2, far + 2, *move) for image, move in zip(images, moves.tolist(), strict=True)]


def _window(image: Pixels, bar: int, side: int, right: int, down: int) -> Pixels:
    """All black but what is so far from the edges, in a window that has moved."""
    height, width = image.shape[:2]
    shown = slice(bar + down, height - bar + down), slice(side + right, width - side + right)
    out = np.zeros_like(image)
    out[shown] = image[shown]
    return out


def _clock(images: Sequence[Pixels]) -> list[Pixels]:
    return [
        _stamped(image, f"{7 * k % 24:02d}:{11 * k % 60:02d}.{37 * k % 1000:03d}") for k, image in enumerate(images)
    ]


def _stamped(image: Pixels, text: str) -> Pixels:
    where, font = np.zeros(image.shape[:2], np.uint8), cv2.FONT_HERSHEY_SIMPLEX
    cv2.putText(where, text, (4, image.shape[0] - 5), font, 0.35, 255, 1)
    share = where.reshape(*where.shape, *[1] * (image.ndim - 2)) / 255.0
    return counts(image * (1 - share) + np.iinfo(image.dtype).max * share, image)


ALTERATIONS: dict[str, Callable[[Sequence[Pixels]], list[Pixels]]] = {
    "jpeg": _jpeg,
    "video": _video,
    "denoised": _denoised,
    "sharpened": _sharpened,
    "black": _black,
    "full": _full,
    "gamma": _gamma,
    "gain": _gain,
    "steps": _steps,
    "bars": _bars,
    "stabilised": _stabilised,
    "clock": _clock,
}
