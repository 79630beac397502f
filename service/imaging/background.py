"""What the sky looks like: learned from frames without the object, or from outside of it.

A ``Background`` is what has been posted (stored, opaque to everybody else); a ``Sky`` is what a worker derives
from it once and caches.
"""

from __future__ import annotations

import io
import math
import zipfile
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.imaging.features import FeatureSpec, feature_bins, feature_spec

KEPT_FRAMES = 16  # numerical: enough for a per-pixel median that no star survives
KEPT_BYTES = 64 * 2**20  # numerical: memory of one sky
# prior: share of the uniform distribution mixed into every histogram: no pixel may rule alone
FLOOR = 1e-3


@dataclass(frozen=True)
class Background:
    """The most recent background frames, and the histogram of all of them (p(D|b))."""

    frames: NDArray[np.generic]  # (K, H, W, C) uint8 or uint16
    known: NDArray[np.bool_]  # (H, W) pixels that showed sky
    counts: NDArray[np.float64]  # (bins,) histogram of the feature over all known pixels
    n_frames: int
    bits: int

    @property
    def shape(self) -> tuple[int, int, int]:
        """Height, width, channels."""
        h, w, c = self.frames.shape[1:]
        return h, w, c

    def to_bytes(self) -> bytes:
        """Deterministic blob; inverse of ``from_bytes``."""
        out = io.BytesIO()
        np.savez(
            out,
            frames=self.frames,
            known=self.known,
            counts=self.counts,
            meta=np.array([1, self.n_frames, self.bits], dtype=np.int64),
        )
        return out.getvalue()

    @staticmethod
    def from_bytes(blob: bytes) -> Background:
        """Read a blob made by ``to_bytes``. Raises ``ValueError`` for any other: checkpoints bring blobs too."""
        _require_stored(blob)
        with np.load(io.BytesIO(blob), allow_pickle=False) as data:
            if set(data) != {"frames", "known", "counts", "meta"}:
                raise ValueError("a background's arrays are others")
            version, n_frames, bits = (int(v) for v in data["meta"])
            if version != 1:
                raise ValueError(f"background blob of version {version}, this release reads version 1")
            return Background(data["frames"], data["known"], data["counts"], n_frames, bits)

    def require(self, feature: str, gradient_sigma_px: float) -> None:
        """Raises ``ValueError`` unless its arrays fit each other and the feature's histogram."""
        frames, known, counts = self.frames, self.known, self.counts
        if frames.ndim != 4 or frames.dtype != {8: np.uint8, 16: np.uint16}.get(self.bits) or 0 in frames.shape:
            raise ValueError(f"background frames are {frames.dtype} {frames.shape} of {self.bits} bits")
        if frames.shape[3] not in (1, 3) or len(frames) > KEPT_FRAMES or len(frames) > self.n_frames:
            raise ValueError(f"background of {len(frames)} frames with {frames.shape[3]} channels")
        if len(frames) > 1 and frames.nbytes > KEPT_BYTES:
            raise ValueError("background of too many bytes")
        if known.shape != frames.shape[1:3] or known.dtype != np.bool_ or not known.any():
            raise ValueError("the background's known pixels do not fit its frames")
        spec = feature_spec(feature, frames.shape[3], self.bits, gradient_sigma_px)
        if counts.shape != (spec.n_bins,) or counts.dtype != np.float64:
            raise ValueError(f"the background's histogram is {counts.dtype} {counts.shape}, not of {spec.n_bins} bins")
        if not ((counts >= 0) & (counts <= 1e15)).all():
            raise ValueError("the background's histogram has no counts")


def _require_stored(blob: bytes) -> None:
    """Nothing in the archive is packed, and each array is as long as its header says: no bomb, no huge claim."""
    try:
        with zipfile.ZipFile(io.BytesIO(blob)) as archive:
            for entry in archive.infolist():
                if entry.compress_type != zipfile.ZIP_STORED or entry.file_size > len(blob):
                    raise ValueError("a background's arrays are packed")
                with archive.open(entry) as stream:
                    np.lib.format.read_magic(stream)
                    shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
                    if math.prod(shape) * dtype.itemsize > entry.file_size or dtype.hasobject:
                        raise ValueError("a background's array is cut short")
    except (zipfile.BadZipFile, EOFError, OSError, RuntimeError, NotImplementedError) as error:
        raise ValueError(f"no background: {error}") from error


def learn(
    background: Background | None,
    image: NDArray[np.generic],
    bits: int,
    spec: FeatureSpec,
    known: NDArray[np.bool_],
) -> Background:
    """Add one image (H, W) or (H, W, C) of which the ``known`` pixels (H, W) show sky."""
    frame = image[..., None] if image.ndim == 2 else image
    counts = np.bincount(feature_bins(image, spec)[known], minlength=spec.n_bins).astype(np.float64)
    if background is None:
        return Background(frame[None].copy(), known, counts, 1, bits)
    keep = max(1, min(KEPT_FRAMES, KEPT_BYTES // max(1, frame.nbytes)))
    frames = np.concatenate([background.frames, frame[None]])[-keep:]
    return Background(
        frames, background.known & known, background.counts + counts, background.n_frames + 1, background.bits
    )


def known_pixels(
    height: int,
    width: int,
    box: tuple[float, float, float, float] | None,
    border_px: float | None,
) -> NDArray[np.bool_]:
    """(H, W) which pixels show sky: all, those outside ``box`` (x, y, w, h), or those in the border."""
    known = np.ones((height, width), dtype=bool)
    if box is not None:
        x, y, w, h = box
        known[max(0, round(y)) : max(0, round(y + h)), max(0, round(x)) : max(0, round(x + w))] = False
    if border_px is not None:
        b = max(1, round(border_px))
        known[b : max(b, height - b), b : max(b, width - b)] = False
    return known
