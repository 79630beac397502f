"""A grid of integer shifts: one outline on a wider canvas, looked up in prefix sums that are wider still."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpu.prefix import fixed_point_prefix

LANES = 16
BITS = 26  # sixteen rows' sums fit into 32 bits


@dataclass(frozen=True)
class ShiftGrid:
    """All shifts between the least and the greatest of those asked for; ``columns`` rounded up to whole vectors."""

    first: tuple[int, int]  # least dx, dy
    rows: int
    columns: int
    margin: int  # the canvas is this much wider than the map on every side

    @classmethod
    def around(cls, shifts: NDArray[np.int64]) -> ShiftGrid:
        """The grid that holds (S, 2) shifts dx, dy."""
        low, high = shifts.min(axis=0), shifts.max(axis=0)
        columns = -(-int(high[0] - low[0] + 1) // LANES) * LANES
        return cls((int(low[0]), int(low[1])), int(high[1] - low[1] + 1), columns, int(np.abs(shifts).max()))

    def pick(self, scores: NDArray[np.int64], shifts: NDArray[np.int64]) -> NDArray[np.int64]:
        """(N, rows, columns) -> (N, S) at the (S, 2) shifts."""
        return scores[:, shifts[:, 1] - self.first[1], shifts[:, 0] - self.first[0]]

    def table(self, log_ratio: NDArray[np.float32]) -> tuple[NDArray[np.int32], float, int, int]:
        """Prefix sums with room for every shift: the table (H + 4 m, W + 4 m + 1 + LANES), the value of one unit, the
        place of the first shift in the flattened table, and the table's width.

        Canvas row Y is map row Y - m; shifted by dy it is row Y - m + dy, which the table has 2 m further down, since
        it begins 2 m above the map. Columns are alike.
        """
        m = self.margin
        prefix, units = fixed_point_prefix(log_ratio[None], BITS)
        height, width = prefix.shape[1:]
        table = np.zeros((height + 4 * m, width + 4 * m + LANES), np.int32)
        rows = table[2 * m : 2 * m + height]
        rows[:, 2 * m : 2 * m + width] = prefix[0]
        rows[:, 2 * m + width :] = prefix[0, :, -1:]
        dx, dy = self.first
        return table, float(units[0]), (m + dy) * table.shape[1] + m + dx, table.shape[1]
