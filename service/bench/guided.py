"""Passes as a telescope shows them that is guided by hand: the body is elsewhere in every frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from service.bench.brightness import counts, pixels
from service.bench.cases import Case, TruthFrame
from service.simulate.folder import encode_png

_RIM = 1.1  # of the body's radius that stays within the image


def by_hand(case: Case, most: int) -> Case:
    """The case with every frame moved by up to ``most`` px along each axis, the body staying within it.

    The sky stays with the sensor. What leaves the image on one side comes in on the other: noise, and stars.
    """
    width, height = case.size
    empty = [pixels(body).astype(np.float32) for body in case.backgrounds()]
    sky = np.float32(np.rint(np.median(empty, axis=0))) if empty else np.float32(0)

    def frames() -> Iterator[tuple[bytes, TruthFrame]]:
        rng = np.random.default_rng(0)
        for body, truth in case.frames():
            rim = _RIM * case.model.mesh.radius * truth.scale
            low = np.minimum(np.maximum(rim - truth.position, -most), 0.0)
            high = np.maximum(np.minimum(np.array([width, height]) - rim - truth.position, most), 0.0)
            move = np.trunc(rng.uniform(low, high)).astype(int)
            image = pixels(body)
            moved = counts(sky + np.roll(image - sky, move[::-1], (0, 1)), image)
            yield encode_png(moved), replace(truth, position=truth.position + move)

    return replace(case, frames=frames)
