"""How often the whole space is searched beside a track (docs/model.md, section 6)."""

from __future__ import annotations

import numpy as np

from service.inference.filters.given import Updated
from service.inference.filters.status import found_share
from service.inference.model import existence
from service.inference.model.spread import PointSpread
from service.inference.model.stages import WHOLE, Part
from service.inference.state import Mixture

_EAGER = 4  # numerical: searches of a leader, one frame after the other
# numerical: of them for a body that is resolved, where a truth that was missed is less likely than this
_EAGER_IF_SURE, _SURE = 2, 0.01
_RESOLVED = 34.0  # numerical: widths of the point spread across its light
_SOON = 3  # numerical: frames to the next search of a track that may have missed the truth
# numerical: wrong answers that a search of a settled track is worth
_WORTH = 0.15
# numerical: frames over which it goes on, at the least; and at the most, for no law says how tracks go wrong later
_LEAST_BETWEEN, _MOST_BETWEEN = 9, 1000
# numerical: frames a part of a search that goes on over them, and the most parts: four take as long together as a whole
# search, twelve twice as long, but keep a frame half as long
_FRAMES_A_PART, _MOST_PARTS = 3, 12


def is_doubted(mixture: Mixture, mesh_error: float = 0.0) -> bool:
    """Whether the light that is seen is rather something else's, or the truth is not among the modes."""
    _, fits, no_fit = mixture.existence
    return bool(no_fit + fits * (1 - found_share(mixture, mesh_error)) >= 0.5)


def explains(mixture: Mixture) -> bool:
    """Whether this body rather explains the light that is seen, were the truth among the modes."""
    return bool(mixture.existence[existence.FITS] >= 0.5)


def is_open(mixture: Mixture, mesh_error: float = 0.0) -> bool:
    """Whether two searches may have missed the truth: of little light, blurred, of what fits worse or is not alone."""
    missed = existence.missed(mixture.searches, mixture.misses, nats=mixture.searched_nats)
    known = mixture.ever_tracked and mixture.misses == 0 and not is_doubted(mixture, mesh_error)
    return not known or missed > _SURE or widths_across(mixture) < _RESOLVED


def widths_across(mixture: Mixture) -> float:
    """Of the light, in widths of the point spread."""
    return mixture.span_px / PointSpread(*mixture.point_spread).width


def frames_between(mixture: Mixture) -> int:
    """Frames in which the next search of a settled track is expected to save as many wrong answers as it is worth.

    It saves one a frame where the truth was missed by all before, and it meets it.
    """
    missed, still = (
        existence.missed(mixture.searches + more, mixture.misses, nats=mixture.searched_nats) for more in (0, 1)
    )
    return int(np.clip(_WORTH / (missed - still), _LEAST_BETWEEN, _MOST_BETWEEN))


def part_due(before: Mixture | None, most_parts: int = _MOST_PARTS, mesh_error: float = 0.0) -> Part | None:
    """As often as it is likely that the truth was missed; a track that many searches could not better has few.

    They go on over the frames between them, part after part, so that no frame has to wait for a whole one.
    """
    eager = _EAGER if before is None or is_open(before, mesh_error) else _EAGER_IF_SURE
    if before is None or before.searches < eager:
        return WHOLE
    frames = before.since_search + 1
    if before.existence[existence.ABSENT] >= 0.5:  # what comes back is within reach of its prediction, as a rule
        return WHOLE if frames > 1 else None
    if before.searches < eager + before.misses or is_doubted(before, mesh_error):
        return WHOLE if frames >= _SOON else None
    between = frames_between(before)
    count = min(between // _FRAMES_A_PART, _MOST_PARTS, most_parts)
    part = Part(min(before.parts_searched, count - 1), count)
    return part if frames * count >= between * (part.number + 1) else None


def searched_nats(before: Mixture | None, searched: bool, updated: Updated) -> float:
    """Log evidence of the best mode against the empty sky, as searches see it, the mean of the frames searched."""
    nats = existence.nats_of_search(updated.nats, updated.hidden)
    if before is None:
        return nats
    if not searched or updated.existence[existence.ABSENT] >= 0.5:
        return before.searched_nats
    known = before.searches + before.misses
    return (known * before.searched_nats + nats) / (known + 1)
