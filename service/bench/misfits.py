"""Frames that a model must not explain: another body's, mirrored ones, what passes before the body.

Each is a case whose later frames are spoilt; what counts is what the filter says of itself, not a pose.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from service.bench.brightness import counts, grey, pixels
from service.bench.cases import Case, TruthFrame
from service.bench.runner import Entry, Terms, open_session
from service.bench.scoring import Referee
from service.bench.summary import WITHIN_DEG
from service.imaging.decode import Pixels
from service.simulate.folder import encode_png
from service.workers.tracker import Tracker

NOTICED = ("no_fit", "lost", "ambiguous")
WITHIN = 5  # frames in which it should be noticed
BEFORE = 5  # frames before those that are spoilt, where only some are
_CLOUD = 0.1  # of the light that comes through
_CLOUD_EDGE = 0.1  # of the body's radius
_BIRD, _BIRD_AT = 0.8, (0.6, 0.2)  # of the body's radius: a bird's own, and its place to the right of and below it
_TRAIL, _TRAIL_PX, _TRAIL_AT_PX = 0.6, 1.5, 3.0  # share of full scale; width; how far from the body's middle
_TRAIL_ACROSS, _TRAIL_DOWN = 0.6, -0.8  # normal of a trail


@dataclass(frozen=True)
class MisfitRow:
    """What was said of one spoilt pass. ``from_frame`` is the first that is spoilt."""

    kind: str  # one of ``KINDS``
    case: str
    model: str  # that it was followed with
    from_frame: int
    noticed_after: int | None  # frames, 1: at once; None: never
    tracking: float  # share of the spoilt frames
    last: str
    statuses: tuple[str, ...]
    wrong: float | None = None  # share of the spoilt frames that is ``tracking`` and off; None: there is no right pose
    count: int | None = None  # frames that are spoilt; None: all others
    back_after: int | None = None  # frames after them until it is ``tracking`` and right; None: never

    @property
    def in_time(self) -> bool:
        """Whether it was noticed soon enough."""
        return self.noticed_after is not None and self.noticed_after <= WITHIN


@dataclass(frozen=True)
class Misfit:
    """A case whose frames are spoilt from ``from_frame`` on, or ``count`` of them."""

    kind: str
    case: Case
    from_frame: int
    count: int | None = None


def wrong_meshes(cases: Sequence[Case], most: int) -> Iterator[Misfit]:
    """The first case of each of the first ``most`` bodies, followed with each other body's mesh."""
    bodies = list({case.model.key: case for case in reversed(cases)}.values())[::-1][:most]
    for case in bodies:
        for other in bodies:
            if other is not case:
                swapped = replace(case, model=other.model, free=other.free, scale_prior=None)
                yield Misfit("mesh", swapped, 0)


def mirrored(case: Case, from_frame: int, count: int | None = None) -> Misfit:
    """Left and right change places about the body's middle."""

    def flip(image: Pixels, truth: TruthFrame) -> Pixels:
        across = round(2 * float(truth.position[0]) - image.shape[1])
        return np.roll(image[:, ::-1], across, axis=1)

    return Misfit("mirror", _spoilt(case, from_frame, count, flip), from_frame, count)


def clouded(case: Case, from_frame: int, count: int | None = None) -> Misfit:
    """A tenth of the light comes through over the brighter half of the body, left or right."""
    sky = np.mean([pixels(body) for body in case.backgrounds()], axis=0)
    first, truth = next(islice(case.frames(), from_frame, None))
    light = np.clip(grey(first) - sky.reshape(*sky.shape[:2], -1).mean(axis=2), 0, None)
    left_of = np.arange(light.shape[1]) < truth.position[0]
    side = 1.0 if light[:, left_of].sum() > light[:, ~left_of].sum() else -1.0

    def cover(image: Pixels, truth: TruthFrame) -> Pixels:
        edge = _CLOUD_EDGE * case.model.mesh.radius * truth.scale
        behind = side * (truth.position[0] - np.arange(image.shape[1]) - 0.5) / edge
        through = 1 - (1 - _CLOUD) / (1 + np.exp(-np.clip(behind, -50, 50)))
        through = through.reshape(1, -1, *[1] * (image.ndim - 2))
        return counts(sky + (image - sky) * through, image)

    return Misfit("cloud", _spoilt(case, from_frame, count, cover), from_frame, count)


def crossed(case: Case, from_frame: int, count: int | None = None) -> Misfit:
    """A dark bird, or another body, lets no light through over much of the body."""
    sky = np.mean([pixels(body) for body in case.backgrounds()], axis=0)

    def cover(image: Pixels, truth: TruthFrame) -> Pixels:
        across, down = _from_body(image, truth)
        radius = case.model.mesh.radius * truth.scale
        there = np.hypot(across - _BIRD_AT[0] * radius, down - _BIRD_AT[1] * radius) < _BIRD * radius
        return np.where(there, counts(sky, image), image)

    return Misfit("bird", _spoilt(case, from_frame, count, cover), from_frame, count)


def trailed(case: Case, from_frame: int, count: int | None = None) -> Misfit:
    """Another satellite's bright trail runs through the body."""

    def add(image: Pixels, truth: TruthFrame) -> Pixels:
        across, down = _from_body(image, truth)
        off = _TRAIL_ACROSS * across + _TRAIL_DOWN * down - _TRAIL_AT_PX
        light = _TRAIL * np.iinfo(image.dtype).max * np.exp(-0.5 * (off / _TRAIL_PX) ** 2)
        return counts(image + light, image)

    return Misfit("trail", _spoilt(case, from_frame, count, add), from_frame, count)


SPOILT = {"mirror": mirrored, "cloud": clouded, "bird": crossed, "trail": trailed}
KINDS = ("mesh", *SPOILT)


def run_misfit(tracker: Tracker, misfit: Misfit, entry: Entry, terms: Terms) -> MisfitRow:
    """Follow one, and say when it was noticed."""
    case = misfit.case
    session = open_session(tracker, case, entry, list(case.backgrounds()), terms.told)
    referee = None if misfit.kind == "mesh" else Referee(case)  # under another mesh no pose is right
    said, right = [], []
    for k, (body, truth) in enumerate(islice(case.frames(), terms.limit)):
        estimate = session.track(tracker, k, truth.time_s, body, terms.told.light_at(truth)).estimate
        said.append(estimate.status)
        right.append(referee is not None and referee.error_deg(truth, estimate.best) <= WITHIN_DEG)
    end = len(said) if misfit.count is None else misfit.from_frame + misfit.count
    spoilt, good = said[misfit.from_frame : end], right[misfit.from_frame : end]
    wrong = sum(status == "tracking" and not well for status, well in zip(spoilt, good, strict=True))
    after = zip(said[end:], right[end:], strict=True)
    back = next((k + 1 for k, (status, well) in enumerate(after) if status == "tracking" and well), None)
    noticed = next((k + 1 for k, status in enumerate(spoilt) if status in NOTICED), None)
    share = spoilt.count("tracking") / len(spoilt)
    return MisfitRow(
        kind=misfit.kind,
        case=case.name,
        model=case.model.name,
        from_frame=misfit.from_frame,
        noticed_after=noticed,
        tracking=share,
        last=spoilt[-1],
        statuses=tuple(said),
        wrong=None if misfit.kind in ("mesh", "mirror") else wrong / len(spoilt),  # of those no pose is right
        count=misfit.count,
        back_after=back,
    )


def _from_body(image: Pixels, truth: TruthFrame) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Px that each pixel's centre lies to the right of the body's place, and below it: (1, W), (H, 1), and as many
    axes as the image has.
    """
    channels, (height, width) = [1] * (image.ndim - 2), image.shape[:2]
    across, down = np.arange(width) + 0.5 - truth.position[0], np.arange(height) + 0.5 - truth.position[1]
    return across.reshape(1, -1, *channels), down.reshape(-1, 1, *channels)


def _spoilt(case: Case, first: int, count: int | None, spoil: Callable[[Pixels, TruthFrame], Pixels]) -> Case:
    def frames() -> Iterator[tuple[bytes, TruthFrame]]:
        for k, (body, truth) in enumerate(case.frames()):
            as_it_is = k < first or (count is not None and k >= first + count)
            yield (body if as_it_is else encode_png(spoil(pixels(body), truth))), truth

    return replace(case, frames=frames)
