"""What ``kernels/evidence.cl`` is told of a patch beside its drawings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float32]
_OWN = ("mean", "precision")
LANES = 16  # as the kernel has them
_REACH = 3.5  # sigmas of a Gaussian that are summed


class Facets(Protocol):
    """Which of P positive planes are facets of one piece, and how alike they are."""

    @property
    def piece(self) -> NDArray[np.int32]:
        """(P,) numbers, in rising order."""
        ...

    @property
    def own(self) -> Numbers:
        """(P,) precision about what the facets of a piece have in common; 0: a plane is alone."""
        ...

    @property
    def common(self) -> Numbers:
        """(P,) precision of that."""
        ...


class Terms(Protocol):
    """What one patch and its priors are to the kernel. Pictures are (S, S), S a multiple of 16."""

    @property
    def data(self) -> Numbers:
        """(S, S) the frame after its low pass."""
        ...

    @property
    def full(self) -> NDArray[np.bool_]:
        """(S, S) pixels of which only a least value is known."""
        ...

    @property
    def stars(self) -> NDArray[np.uint8]:
        """(S, S) numbers of pieces of light that may be a star's, 1 to 127; 0 elsewhere."""
        ...

    @property
    def slopes(self) -> Numbers:
        """(3, S, S) level of the sky and its slopes."""
        ...

    @property
    def behind(self) -> Numbers:
        """(S, S) light of the sky that can be hidden at a place, over its level."""
        ...

    @property
    def bumps(self) -> Numbers:
        """(9, S, S) where the air shifts the image alike."""
        ...

    @property
    def gaussians(self) -> tuple[tuple[float, float], ...]:
        """Weight, sigma (px) of what blurs a drawing."""
        ...

    @property
    def offset(self) -> Numbers:
        """(Q - 4,) log of each positive plane's share of the gain."""
        ...

    @property
    def facets(self) -> Facets:
        """Which positive planes are alike."""
        ...

    @property
    def mean(self) -> Numbers:
        """(Q - 4 + 9 + ...,): positives, gain, even, hidden, sky (3), tilt of the even light (3), speckle, shifts."""
        ...

    @property
    def precision(self) -> Numbers:
        """The same of their precisions."""
        ...

    @property
    def start(self) -> Numbers | None:
        """(N, U) where the unknowns of N poses begin; None: at ``mean``, the gain as it fits best."""
        ...

    @property
    def noise(self) -> float:
        """Variance of a pixel of empty sky."""
        ...

    @property
    def photon(self) -> float:
        """Variance per count."""
        ...

    @property
    def hidden(self) -> float:
        """Light of the sky that a body can hide, counts."""
        ...

    @property
    def area(self) -> float:
        """A: pixels that count as one."""
        ...

    @property
    def wrong(self) -> float:
        """C tau^2."""
        ...

    @property
    def edge(self) -> float:
        """Px by which edges are misplaced, in units of tau."""
        ...

    @property
    def width(self) -> float:
        """Of the point spread, px."""
        ...

    @property
    def gain(self) -> float:
        """Log gain to start from."""
        ...

    @property
    def star(self) -> float:
        """Nats against a star at a place."""
        ...

    @property
    def speckle(self) -> bool:
        """Whether the point spread's deviations are unknowns."""
        ...

    @property
    def shifts(self) -> bool:
        """Whether image shifts are unknowns."""
        ...


@dataclass(frozen=True)
class PatchInputs:
    """What all poses on a patch have in common, and of which of its terms' arrays it is made."""

    of: tuple[NDArray[np.generic], ...]
    data: Numbers
    marks: NDArray[np.uint8]
    sky: Numbers  # slopes, and the sky behind
    bumps: Numbers
    boxes: NDArray[np.int32]  # of stars
    n_stars: int

    def is_of(self, terms: Terms) -> bool:
        """Whether these are the very arrays of such terms."""
        return all(mine is its for mine, its in zip(self.of, _of_patch(terms), strict=True))


@dataclass(frozen=True)
class HostInputs:
    """Of N poses, in the order in which the kernel takes them."""

    # offset, mean, precision, start, pieces, ties, data, marks, slopes and sky behind, bumps, weights, radii, taps,
    # boxes
    arrays: tuple[NDArray[np.generic], ...]
    every: int  # priors from one pose to the next; 0: all have the same
    started: bool  # whether `start` says where unknowns begin
    n_stars: int
    scalars: tuple[float, ...]
    spreads: NDArray[np.int32]  # (N, 4)
    own: Numbers  # (N, 4)
    patch: PatchInputs
    radius: int  # of the widest spread, px


def patch_of(terms: Terms) -> PatchInputs:
    """Of such terms."""
    boxes = boxes_of(terms.stars)
    sky = np.concatenate([terms.slopes, terms.behind[None]])
    marks, some = terms.full.astype(np.uint8) | terms.stars << 1, boxes if len(boxes) else np.zeros((1, 5), np.int32)
    data, bumps = np.ascontiguousarray(terms.data), np.ascontiguousarray(terms.bumps)
    return PatchInputs(_of_patch(terms), data, np.ascontiguousarray(marks), sky, bumps, some, len(boxes))


def _of_patch(terms: Terms) -> tuple[NDArray[np.generic], ...]:
    return terms.data, terms.full, terms.stars, terms.slopes, terms.behind, terms.bumps


def inputs_of(several: Sequence[Terms], numbers: Sequence[int], patch: PatchInputs) -> HostInputs:
    """``several``: the terms of all poses, or of each its own; ``numbers`` (N,): which of the drawn ones they are;
    ``patch``: the one that they share.
    """
    terms, mean, precision = several[0], several[0].mean, several[0].precision
    if len(several) > 1:
        mean, precision = (np.stack([np.atleast_2d(getattr(one, k))[0] for one in several]) for k in _OWN)
    each = several if len(several) == len(numbers) else [terms] * len(numbers)
    spreads, weights, taps = spreads_of([one.gaussians for one in each] or [terms.gaussians], numbers)
    radii = np.array([len(t) // 2 for t in taps], np.int32)
    starts = [one.start for one in several if one.start is not None]
    start = np.concatenate([np.atleast_2d(one) for one in starts]) if starts else np.zeros((1, 1), np.float32)
    pieces, ties = np.asarray(terms.facets.piece, np.int32), np.stack([terms.facets.own, terms.facets.common])
    arrays = (terms.offset, mean, precision, start, pieces, ties, patch.data, patch.marks, patch.sky, patch.bumps)
    scalars = (terms.noise, terms.area, terms.edge**2, terms.gain, terms.star)
    own = np.array([(one.wrong, one.width, one.photon, one.hidden) for one in each], np.float32)
    whole = (*arrays, weights, radii, np.concatenate(taps), patch.boxes)
    every = mean.shape[1] if mean.ndim == 2 else 0
    return HostInputs(whole, every, bool(starts), patch.n_stars, scalars, spreads, own, patch, int(radii.max()))


def boxes_of(stars: NDArray[np.uint8]) -> NDArray[np.int32]:
    """(K, 5) of each number its own, first and last row, first and last column of whole lanes (ends exclusive)."""
    out = []
    for number in np.unique(stars[stars > 0]) if stars.any() else ():
        rows, columns = np.nonzero(stars == number)
        left, right = columns.min() // LANES * LANES, -(-(columns.max() + 1) // LANES) * LANES
        out.append((number, rows.min(), rows.max() + 1, left, right))
    return np.array(out, np.int32).reshape(-1, 5)


def spreads_of(
    gaussians: Sequence[tuple[tuple[float, float], ...]], numbers: Sequence[int]
) -> tuple[NDArray[np.int32], Numbers, list[Numbers]]:
    """(N, 4) rows as the kernel reads them; weights and taps of all components that poses have, each spread once."""
    places: dict[tuple[tuple[float, float], ...], tuple[int, int, int]] = {}
    weights: list[float] = []
    taps: list[Numbers] = []
    for spread in gaussians:
        if spread not in places:
            places[spread] = len(taps), len(spread), sum(map(len, taps))
            weights += [weight for weight, _ in spread]
            taps += [_taps(sigma) for _, sigma in spread]
    rows = [(*places[spread], number) for spread, number in zip(gaussians, numbers, strict=False)]
    return np.array(rows, np.int32).reshape(-1, 4), np.array(weights, np.float32), taps


def _taps(sigma: float) -> Numbers:
    radius = max(1, int(np.ceil(_REACH * sigma)))
    taps = np.exp(-0.5 * (np.arange(-radius, radius + 1) / max(sigma, 1e-3)) ** 2)
    return np.asarray(taps / taps.sum(), np.float32)
