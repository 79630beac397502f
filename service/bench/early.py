"""Passes whose frames begin before the body is in view: what is seen then, noise and stars, is none of its light."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

import numpy as np

from service.bench.cases import Case, TruthFrame
from service.bench.folder import SequenceError


def begun_early(case: Case, count: int) -> Case:
    """The case with ``count`` of its empty frames ahead of the others, as far apart; the rest tell the sky.

    Raises ``SequenceError`` where no empty frame would be left, or the pass has but one frame.
    """
    empty, times = list(case.backgrounds()), [truth.time_s for _, truth in islice(case.frames(), 2)]
    if len(empty) <= count or len(times) < 2:
        raise SequenceError(f"{case.name} has {len(empty)} empty frames: too few for {count} ahead of the pass")
    step_s = times[1] - times[0]
    nowhere = TruthFrame(0.0, np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(2), 1.0, {}, False)

    def frames() -> Iterator[tuple[bytes, TruthFrame]]:
        for k in range(count):
            yield empty[k], replace(nowhere, time_s=times[0] + k * step_s)
        for body, truth in case.frames():
            yield body, replace(truth, time_s=truth.time_s + count * step_s)

    return replace(case, backgrounds=lambda: iter(empty[count:]), frames=frames)
