"""Passes of which the frame's edge cuts a part of the body off, as where a telescope is guided by hand."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from service.bench.brightness import pixels
from service.bench.cases import Case, TruthFrame
from service.bench.folder import SequenceError
from service.simulate.folder import encode_png


def cut_off(case: Case, share: float) -> Case:
    """The case in images that end where ``share`` of the body's diameter lies below them in the middle of the pass.

    Raises ``SequenceError`` where nothing would be left of an image.
    """
    truths = [truth for _, truth in case.frames()]
    truth, (width, height) = truths[len(truths) // 2], case.size
    diameter = 2 * case.model.mesh.radius * truth.scale
    rows = min(int(np.rint(truth.position[1] + (0.5 - share) * diameter)), height)
    if rows < 1:
        raise SequenceError(f"{case.name}: nothing of the image is above {share} of the body")

    def above(body: bytes) -> bytes:
        return encode_png(pixels(body)[:rows].copy())

    def frames() -> Iterator[tuple[bytes, TruthFrame]]:
        return ((above(body), truth) for body, truth in case.frames())

    return replace(case, size=(width, rows), backgrounds=lambda: map(above, case.backgrounds()), frames=frames)
