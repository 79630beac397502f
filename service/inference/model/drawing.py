"""What the likelihood needs of the room that draws: lit pictures of many poses on one patch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from service.inference.articulation import Articulation, part_transforms
from service.inference.model.prior import GLOSS_LOBES, Around
from service.inference.pose import multiply
from service.inference.state import Array, Poses

Images = NDArray[np.float32]
EVEN_PLANES = 4  # exact: of a drawing: coverage and the three parts of the mean normal, for even light and its tilt


class Cut(Protocol):
    """``gpu.cut.Cut``: (N, Q, S, S) pictures, of which what is dark about the bodies may be left out."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: slice | NDArray[np.intp]) -> Cut:
        """Some of the N."""
        ...

    @property
    def nbytes(self) -> int:
        """That it takes."""
        ...

    def whole(self) -> Images:
        """(N, Q, S, S) with the dark."""
        ...


class Shaded(Protocol):
    """``gpu.shaded.ShadedBody``."""

    def n_planes(self, gloss: tuple[float, ...] = ...) -> int:
        """Q, with so many lobes of gloss."""
        ...

    def cut(
        self,
        part_transforms: NDArray[np.float32],
        towards_sun: Array,
        *,
        side: int,
        supersample: int,
        shadow_px: int,
        gloss: tuple[float, ...] = ...,
        lens: tuple[float, float, float] = ...,
        around: Around = ...,
    ) -> Cut:
        """(N, P, 3, 4) transforms to the patch -> (N, Q, side, side): groups, coverage, normals, gloss of groups."""
        ...

    def combined(
        self,
        part_transforms: NDArray[np.float32],
        towards_sun: Array,
        coefficients: Images,
        *,
        side: int,
        supersample: int,
        shadow_px: int,
        gloss: tuple[float, ...] = ...,
        lens: tuple[float, float, float] = ...,
        around: Around = ...,
    ) -> Images:
        """(N, P, 3, 4) transforms and (Q,) or (N, Q) coefficients -> (N, side, side) sums of the planes."""
        ...

    def pictures(
        self,
        part_transforms: NDArray[np.float32],
        towards_sun: Array,
        *,
        side: int,
        supersample: int,
        shadow_px: int,
        around: Around = ...,
    ) -> Images:
        """(N, P, 3, 4) transforms -> (N, 2, side, side): all groups alike, and the coverage."""
        ...


class Evidence(Protocol):
    """``gpu.evidence.LightEvidence``; its twin is ``service.inference.model.likelihood.fit_light``."""

    def evidence(self, planes: Any, n_groups: int, terms: Any, rounds: int, which: Sequence[int] | None = None) -> Any:
        """(N, Q, S, S) planes -> ``log_evidence``, ``chi2`` (N,) and ``coefficients`` (N, Q).

        ``planes``: a ``Cut``, or an array: their first rows and columns, beyond which all are dark.
        """
        ...

    def details(
        self, planes: Any, n_groups: int, terms: Any, rounds: int, which: Sequence[int] | None = None
    ) -> tuple[Any, Any]:
        """The same, and what each pose's curvature is made of."""
        ...


class Slopes(Protocol):
    """``gpu.slopes.LightSlopes``; its twin is ``service.inference.model.derivatives.mixed``."""

    def mixed(
        self,
        pairs: Images,
        here: Images | None,
        middles: Array,
        mixes: Array,
        blur: Sequence[tuple[float, Images, Images]],
    ) -> Images:
        """(N, D, S, S) derivatives of N blurred pictures."""
        ...

    def systems(self, slopes: Images, rows: Sequence[Any], known: Array | None) -> tuple[Array, ...]:
        """What the derivatives of N poses say of them: ``service.inference.numerics.curvature.eliminated``."""
        ...


@dataclass(frozen=True)
class Quality:
    """How finely a body is drawn: numerical tolerances."""

    supersample: int
    shadow_px: int
    gloss: tuple[float, ...] = GLOSS_LOBES


FINE = Quality(supersample=8, shadow_px=512)  # numerical: fewer samples are felt: the discrepancy may be 0.5 %


@dataclass(frozen=True)
class Lens:
    """A pinhole camera, frame px: its focal length and principal point."""

    focal: float
    middle: tuple[float, float]

    def seen(self, points: Array) -> Array:
        """(..., 2) where points (..., 3), placed as if the body were far away, are seen (``gpu.lens``)."""
        middle = np.asarray(self.middle)
        return np.asarray(middle + (points[..., :2] - middle) / (1 + points[..., 2:] / self.focal))

    def aimed(self, poses: Poses) -> Poses:
        """Poses that were told as if each were looked at along the optical axis."""
        ray = np.column_stack([(poses.position - self.middle) / self.focal, np.ones(len(poses))])
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        turn = np.column_stack([1 + ray[:, 2], -ray[:, 1], ray[:, 0], np.zeros(len(poses))])  # the axis to the ray
        turn /= np.linalg.norm(turn, axis=1, keepdims=True)
        return replace(poses, quaternion=multiply(turn, poses.quaternion))


@dataclass(frozen=True)
class View:
    """A square of the frame: its first corner (frame px), frame px per patch px, patch px a side.

    ``lens``: of a pinhole camera; None: weak perspective. ``around``: the Earth's light (``prior.LightPrior``).
    """

    origin: tuple[float, float]
    binning: float
    side: int
    lens: Lens | None = None
    around: Around = (0.0, 0.0, 0.0, 0.0)

    @property
    def patch_lens(self) -> tuple[float, float, float]:
        """Focal length and principal point, patch px (``gpu.lens``)."""
        if self.lens is None:
            return float("inf"), 0.0, 0.0
        (x, y), (left, top) = self.lens.middle, self.origin
        return self.lens.focal / self.binning, (x - left) / self.binning, (y - top) / self.binning


@dataclass(frozen=True)
class Drawing:
    """A body, articulated, that can be drawn on patches."""

    shaded: Shaded
    light: Evidence
    articulation: Articulation
    n_groups: int
    radius: float  # model units
    slopes: Slopes | None = None  # None: the twin
    pieces: NDArray[np.int32] | None = None  # (G,) of which piece each group is a facet; None: each is one

    def n_planes(self, quality: Quality) -> int:
        """Pictures that are drawn of one pose."""
        return self.shaded.n_planes(quality.gloss)

    def transforms(self, poses: Poses, view: View) -> NDArray[np.float32]:
        """(N, P, 3, 4) to the patch's own pixels."""
        out = part_transforms(self.articulation, poses)
        out[:, :, :2, 3] -= np.asarray(view.origin, np.float32)
        return np.ascontiguousarray(out / np.float32(view.binning))

    def planes(self, poses: Poses, sun: Array, view: View, quality: Quality) -> Images:
        """(N, Q, S, S) pictures of each surface group, coverage and normals (for even light), and of gloss."""
        return self.cut(poses, sun, view, quality).whole()

    def cut(self, poses: Poses, sun: Array, view: View, quality: Quality) -> Cut:
        """``planes``, without what is dark about the bodies."""
        return self.shaded.cut(
            self.transforms(poses, view),
            sun,
            side=view.side,
            supersample=quality.supersample,
            shadow_px=quality.shadow_px,
            gloss=quality.gloss,
            lens=view.patch_lens,
            around=view.around,
        )

    def combined(self, poses: Poses, sun: Array, coefficients: Images, view: View, quality: Quality) -> Images:
        """(N, S, S) pictures with every surface's light as ``coefficients`` (Q,) have it; or (N, Q)."""
        return self.shaded.combined(
            self.transforms(poses, view),
            sun,
            coefficients,
            side=view.side,
            supersample=quality.supersample,
            shadow_px=quality.shadow_px,
            gloss=quality.gloss,
            lens=view.patch_lens,
            around=view.around,
        )
