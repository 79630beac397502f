"""Row prefix sums of maps in fixed point, so that a sum has the same bits in any order and on any device."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from gpu.errors import ScorerError
from gpu.program import constant

BITS = 30  # of a prefix sum
KEPT_MAPS = 4


@dataclass(frozen=True)
class PrefixMaps:
    """Prefix sums on the device, (K, H, W + 1) int32, and per map the value of one unit."""

    buffer: cl.Buffer
    units: NDArray[np.float64]  # (K,) powers of two
    shape: tuple[int, int]  # H, W of the maps


class MapCache:
    """Uploads maps; a read-only array that was uploaded lately is not uploaded again (by identity)."""

    def __init__(self, context: cl.Context) -> None:
        self._context = context
        self._kept: OrderedDict[int, tuple[NDArray[np.float32], PrefixMaps]] = OrderedDict()

    def load(self, maps: NDArray[np.float32]) -> PrefixMaps:
        """(H, W) or (K, H, W) maps -> their prefix sums on the device."""
        if id(maps) in self._kept and not maps.flags.writeable:
            self._kept.move_to_end(id(maps))
            return self._kept[id(maps)][1]
        prefix, units = fixed_point_prefix(maps.reshape(-1, *maps.shape[-2:]))
        loaded = PrefixMaps(constant(self._context, prefix), units, (maps.shape[-2], maps.shape[-1]))
        self._kept[id(maps)] = (maps, loaded)  # the array is kept too, so that its identity stays its own
        while len(self._kept) > KEPT_MAPS:
            self._kept.popitem(last=False)
        return loaded


def fixed_point_prefix(maps: NDArray[np.float32], bits: int = BITS) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """(K, H, W) maps -> (K, H, W + 1) int32 prefix sums along the rows and (K,) value of one unit, a power of two.

    Raises ``ScorerError`` for a map with a value that is not finite.
    """
    prefix = np.zeros((*maps.shape[:2], maps.shape[2] + 1), np.int32)
    units = np.empty(len(maps))
    for k, one in enumerate(maps):
        whole, units[k] = fixed_point(one, bits)
        np.cumsum(whole, axis=1, out=prefix[k, :, 1:])
    return prefix, units


def fixed_point(log_ratio: NDArray[np.float32], bits: int = BITS) -> tuple[NDArray[np.int32], float]:
    """(H, W) map -> the map in whole units, and the value of one unit.

    The unit is the smallest power of two for which no row's sum needs more than ``bits`` bits: rounding a pixel to it
    costs at most W 2^-(bits + 1) of the largest value.
    """
    largest = float(np.abs(log_ratio).max(initial=0.0))
    if not np.isfinite(largest):
        raise ScorerError("the map has a value that is not finite")
    exponent = np.ceil(np.log2(max(largest, 1e-300) * max(1, log_ratio.shape[1]))) - bits
    unit = float(np.exp2(max(exponent, -1000.0)))
    return np.rint(np.asarray(log_ratio, dtype=np.float64) / unit).astype(np.int32), unit
