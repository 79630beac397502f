"""Passes in the midst of a larger image: what a frame costs should go with the object, not with the image."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from service.bench.brightness import counts, pixels
from service.bench.cases import Case, TruthFrame
from service.bench.folder import SequenceError
from service.imaging.own_sky import OF_A_NORMAL
from service.simulate.folder import encode_png

_RING_PX = 8  # of the image's own border, which tells the level and the noise of the sky about it


def on_canvas(case: Case, side: int) -> Case:
    """The case as a camera of ``side`` x ``side`` px would show it. Raises ``SequenceError`` where its images
    are larger.

    Sky and noise of an image's border go on about it; each image has noise of its own, the same at every call.
    """
    left, top = ((side - size) // 2 for size in case.size)
    if min(left, top) < 0:
        width, height = case.size
        raise SequenceError(f"{case.name}: images of {width} x {height} px are larger than a canvas of {side} px")

    def frames() -> Iterator[tuple[bytes, TruthFrame]]:
        for number, (body, truth) in enumerate(case.frames()):
            yield framed(body, side, (1, number)), replace(truth, position=truth.position + np.array([left, top]))

    box = None if case.box is None else (case.box[0] + left, case.box[1] + top, *case.box[2:])
    return replace(
        case,
        size=(side, side),
        backgrounds=lambda: (framed(body, side, (0, number)) for number, body in enumerate(case.backgrounds())),
        frames=frames,
        box=box,
    )


def framed(body: bytes, side: int, seed: tuple[int, int]) -> bytes:
    """A PNG in the midst of a larger one."""
    image = pixels(body)
    height, width = image.shape[:2]
    ring = np.ones((height, width), bool)
    ring[_RING_PX:-_RING_PX, _RING_PX:-_RING_PX] = False
    level = np.median(image[ring], axis=0)
    sigma = OF_A_NORMAL * np.median(np.abs(image[ring] - level), axis=0)
    rng = np.random.default_rng(seed)
    whole = counts(level + sigma * rng.standard_normal((side, side, *image.shape[2:]), np.float32), image)
    top, left = (side - height) // 2, (side - width) // 2
    whole[top : top + height, left : left + width] = image
    return encode_png(whole)
