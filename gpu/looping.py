"""What a scorer that can only do one map at a time makes of several maps."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Transforms = NDArray[np.float32]
Map = NDArray[np.float32]


class LoopingScorer(ABC):
    """Asks ``score`` again for every map."""

    name: str

    @abstractmethod
    def score(self, part_transforms: Transforms, log_ratio: Map) -> Floats:
        """(N, P, 3, 4) transforms, (H, W) map -> (N,) sums of the map under the silhouettes."""

    def score_many(self, part_transforms: Transforms, maps: Map) -> Floats:
        """(N, P, 3, 4) transforms, (K, H, W) maps -> (N, K) sums."""
        return np.stack([self.score(part_transforms, one) for one in maps], axis=1)

    @abstractmethod
    def close(self) -> None:
        """Release the device."""
