"""Square pictures that are dark but for one window: a body seldom fills the patch that it is drawn on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float32]
LANES = 16  # exact: as the kernels have them: a window's columns are whole lanes


@dataclass(frozen=True)
class Window:
    """Rows and columns of a square patch."""

    top: int
    left: int
    rows: int
    columns: int


@dataclass(frozen=True)
class Cut:
    """(N, Q, side, side) pictures, of which one window is kept."""

    values: Numbers  # (N, Q, rows, columns)
    top: int
    left: int
    side: int

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, index: slice | NDArray[np.intp]) -> Cut:
        """Some of the N."""
        return Cut(self.values[index], self.top, self.left, self.side)

    @property
    def window(self) -> Window:
        """Where its values lie."""
        return Window(self.top, self.left, *self.values.shape[2:])

    @property
    def nbytes(self) -> int:
        """That it takes."""
        return self.values.nbytes

    def whole(self) -> Numbers:
        """(N, Q, side, side) with the dark around it."""
        rows, columns = self.values.shape[2:]
        if (rows, columns) == (self.side, self.side):
            return self.values
        out = np.zeros((*self.values.shape[:2], self.side, self.side), np.float32)
        out[:, :, self.top : self.top + rows, self.left : self.left + columns] = self.values
        return out


def cut_of(pictures: Numbers | Cut, side: int) -> Cut:
    """The same; of an array (N, Q, rows, columns) the first rows and columns of the patch."""
    return pictures if isinstance(pictures, Cut) else Cut(pictures, 0, 0, side)


def window_around(transforms: Numbers, boxes: Numbers, side: int) -> Window:
    """Where bodies of parts may be seen. Never empty.

    ``transforms`` (N, P, 3, 4) to pixels; ``boxes`` (P, 7) of the parts at rest: centre, half extents, radius.
    """
    turn = transforms[:, :, :2, :3].astype(np.float64)
    middles = np.einsum("npij,pj->npi", turn, boxes[:, :3]) + transforms[:, :, :2, 3]
    reach = np.einsum("npij,pj->npi", np.abs(turn), boxes[:, 3:6])
    (left, top), (right, bottom) = (middles - reach).min(axis=(0, 1)), (middles + reach).max(axis=(0, 1))
    left, top, right, bottom = (float(np.clip(v, -1.0, side + 1.0)) for v in (left, top, right, bottom))
    first_row, first_column = min(max(int(top) - 2, 0), side - 1), min(max(int(left) - 2, 0), side - 1) // LANES * LANES
    last_row, last_column = min(int(bottom) + 3, side), min(-(-(int(right) + 3) // LANES) * LANES, side)
    return Window(first_row, first_column, max(last_row - first_row, 1), max(last_column - first_column, 1))
