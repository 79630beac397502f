"""Pictures of a body from all sides under one Sun, and the frame held against all of them at once.

Each picture is brought to the same place and size by the moments of what is lit, so that a few shifts and scales of
the frame are enough; the comparison is then one matrix product. The bank is good for as long as the Sun stands still.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from service.inference.articulation import Articulation
from service.inference.model.spread import band
from service.inference.state import Array, Poses

Images = NDArray[np.float32]

SIDE = 16  # numerical: px of a template
KINDS = ("light", "root", "lit", "edges", "outline")
# numerical: root mean square distance of lit pixels from their middle, in a template
_RIM_PX = 3.75
_FIRST_SIDE = 24  # numerical: of the draft from which the moments are taken
_LIT = 0.08  # numerical: of the brighter light: lit from here on
_STEEP = 8.0  # numerical: from dark to lit, of the brighter light
_BRIGHTER, _MOST = 0.99, 1.5  # numerical: quantile that light is a share of, and its greatest share
# numerical: pictures in which templates are compared at first, found of every so many: 0.97 of what they show
_PRINCIPAL, _PRINCIPAL_OF = 64, 4
_BLUR_PX = 0.5  # numerical: of the pictures: rotations lie 12 degrees apart
"""Numerical: sizes of the pictures. None of them decides between poses; what follows the bank does."""


@dataclass(frozen=True)
class Bank:
    """N templates."""

    suns: Array  # (N, 3) each under its own
    poses: Poses  # N; position: of the body's centre from the middle of the lit light, scale: both in template px
    pictures: Images  # (kinds, N, SIDE * SIDE), zero mean, unit length

    def __getitem__(self, index: slice | NDArray[np.bool_]) -> Bank:
        return Bank(self.suns[index], self.poses[index], self.pictures[:, index])

    @property
    def nbytes(self) -> int:
        """Of its pictures, and of what they are mostly made of, found yet or not."""
        return self.pictures.nbytes * (SIDE**2 + _PRINCIPAL) // SIDE**2

    @cached_property
    def principal(self) -> tuple[Images, Images]:
        """The pictures that templates are mostly made of (kinds, SIDE * SIDE, P), and their shares (kinds, N, P)."""
        basis, shares = [], []
        for pictures in self.pictures:
            some = pictures[::_PRINCIPAL_OF]
            basis.append(eigh(some.T @ some, subset_by_index=(SIDE**2 - _PRINCIPAL, SIDE**2 - 1))[1])
            shares.append(pictures @ basis[-1])
        return np.stack(basis), np.stack(shares)


@lru_cache(maxsize=8)
def rotations(count: int) -> Array:
    """(count, 4) rotations evenly over SO(3): super-Fibonacci spirals (Alexa, CVPR 2022)."""
    s = np.arange(count) + 0.5
    inner, outer = np.sqrt(s / count), np.sqrt(1 - s / count)
    # exact: the spirals' own root, of x^4 = x + 4
    a, b = 2 * np.pi * s / np.sqrt(2), 2 * np.pi * s / 1.533751168755204288118041
    out = np.column_stack([inner * np.sin(a), inner * np.cos(a), outer * np.sin(b), outer * np.cos(b)])
    out.flags.writeable = False
    return out


def directions(count: int) -> Array:
    """(count, 3) directions evenly over the sphere (Fibonacci's), in an order that rotations do not share."""
    k = np.arange(count)
    # exact: of the plastic number, and of a few directions the golden ratio's
    down, turn = (0.7548776662466927, 0.5698402909980532) if count > 64 else (0.0, 0.6180339887498949)
    z = 1 - 2 * ((k * down + 0.5) % 1.0) if count > 64 else 1 - (2 * k + 1) / count
    angle = 2 * np.pi * ((k * turn) % 1.0)
    ring = np.sqrt(np.maximum(1 - z * z, 0))
    return np.column_stack([ring * np.cos(angle), ring * np.sin(angle), z])


def drawn_joints(articulation: Articulation, count: int) -> Array:
    """(count, J) joint values evenly over their ranges: Roberts' R sequence, whose steps rotations do not share."""
    n = articulation.n_joints
    root = 2.0
    for _ in range(40):  # of x^(n + 1) = x + 1
        root = (1 + root) ** (1 / (n + 1))
    share = (0.5 + np.arange(count)[:, None] * root ** -np.arange(1.0, n + 1)) % 1.0
    low = np.array([joint.minimum for joint in articulation.joints])
    high = np.array([joint.maximum for joint in articulation.joints])
    return np.asarray(low + share * (high - low)).reshape(count, n)


def lit_moments(light: Images) -> tuple[Array, Array]:
    """(N, S, S) -> centres (N, 2) x, y in px (outer corners) and root mean square radii (N,) of what is lit."""
    top = brighter(light)
    lit = light > np.maximum(_LIT * top, 1e-6)[:, None, None]
    at = np.arange(light.shape[-1]) + 0.5
    total = np.maximum(lit.sum(axis=(1, 2)), 1)
    across, down = lit.sum(axis=1), lit.sum(axis=2)
    middle = np.column_stack([across @ at, down @ at]) / total[:, None]
    square = (across @ at**2 + down @ at**2) / total - (middle**2).sum(axis=1)
    return middle, np.sqrt(np.maximum(square, 0.25))


def normalised(pictures: Images) -> Images:
    """(N, S, S) -> (N, S * S) with zero mean and unit length; a flat picture becomes zeros."""
    flat = pictures.reshape(len(pictures), -1)
    flat = flat - flat.mean(axis=1, keepdims=True)
    length = np.sqrt(np.einsum("nk,nk->n", flat, flat))[:, None]
    flat *= np.where(length > 1e-6, 1 / np.maximum(length, 1e-6), 0.0)
    return np.asarray(flat, np.float32)


def brighter(light: Images) -> Images:
    """(N,) what a hundredth of each picture's pixels exceed."""
    flat = light.reshape(len(light), -1)
    rank = round(_BRIGHTER * (flat.shape[1] - 1))
    return np.asarray(np.partition(flat, rank, axis=1)[:, rank], np.float32)


def kinds_of(light: Images, outline: Images, out: Images | None = None) -> Images:
    """(N, S, S) light and outline -> (kinds, N, S * S), into ``out`` where it is given."""
    out = np.empty((len(KINDS), len(light), light[0].size), np.float32) if out is None else out
    scaled = np.clip(light / np.maximum(brighter(light), 1e-6)[:, None, None], 0, _MOST).astype(np.float32)
    root = np.sqrt(scaled)
    lit = np.clip((scaled - _LIT) * _STEEP + 0.5, 0, 1)
    for picture, kind in zip((scaled, root, lit, _edges(root), outline), out, strict=True):
        kind[:] = normalised(_soft(picture))
    return out


def _edges(images: Images) -> Images:
    """(N, S, S) steepness, by Sobel's differences."""
    wide = np.pad(images, ((0, 0), (1, 1), (1, 1)), mode="edge")
    down = wide[:, :-2] + 2 * wide[:, 1:-1] + wide[:, 2:]
    across = wide[:, :, :-2] + 2 * wide[:, :, 1:-1] + wide[:, :, 2:]
    return np.asarray(np.sqrt((down[:, :, 2:] - down[:, :, :-2]) ** 2 + (across[:, 2:] - across[:, :-2]) ** 2))


def _soft(pictures: Images) -> Images:
    """(N, S, S) blurred by ``_BLUR_PX``."""
    matrix = band(pictures.shape[-1], _BLUR_PX)
    return np.asarray(matrix @ pictures @ matrix, np.float32)
