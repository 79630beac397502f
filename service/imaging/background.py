"""What the sky looks like: learned from frames without the object, or from outside of it.

A ``Background`` is what has been posted (stored, opaque to everybody else); a ``Sky`` is what a worker derives
from it once and caches.
"""

from __future__ import annotations

import io
import math
import zipfile
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from service.imaging.clutter import Box, cluttered_box
from service.imaging.features import FeatureSpec, feature_bins, feature_spec
from service.imaging.own_sky import filled

KEPT_FRAMES = 16  # numerical: enough for a per-pixel median that no star survives
_HOT_SIGMAS, _LEAST_SIGMA = 6.0, 0.3  # numerical: above a smooth sky: a hot pixel; counts
_SQUARE, _CHANCE = 8, 6.0  # numerical: px that noise may be alike over; standard deviations
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


@dataclass(frozen=True)
class Sky:
    """Derived from a background, cached by content."""

    mean: NDArray[np.float32]  # (H, W, C) brightness per pixel
    covariance: NDArray[np.float64]  # (C, C) of one pixel's noise, as loud over squares as if it were white
    log_density: NDArray[np.float64]  # (bins,) log p(D|b) of the feature
    spec: FeatureSpec
    clutter: Box | None = None  # in which the body was told to lie, where there is more than sky about it

    @property
    def sigma(self) -> NDArray[np.float64]:
        """(C,) noise of one pixel."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


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


def derive(background: Background, feature: str, gradient_sigma_px: float) -> Sky:
    """Mean, noise and p(D|b) of a background.

    The mean is the per-pixel median over frames whose own level has been taken out, lightly smoothed while there
    are few frames, and a smooth surface through what is known where no frame showed the sky; the noise is the
    deviation about it without outliers, so stars do not count.
    """
    channels = background.shape[2]
    spec = feature_spec(feature, channels, background.bits, gradient_sigma_px)
    counts = background.counts
    density = (1 - FLOOR) * counts / max(1.0, counts.sum()) + FLOOR / spec.n_bins
    frames = background.frames.astype(np.float32)
    known = background.known
    level = np.median(frames[:, known], axis=1)[:, None, None]
    mean = np.asarray(np.median(frames - level, axis=0), np.float32)
    if not known.all():  # elsewhere it is the object that was seen
        mean = filled(mean, known)
    residual = frames - level - mean
    noise = _noise(residual[:, known])
    if len(frames) < KEPT_FRAMES:
        smooth = np.stack([_smooth_sky(mean[..., c]) for c in range(channels)], axis=-1)
        residual = frames - level - smooth
        noise = _noise(residual[:, known])
        stands = mean - smooth
        hot = np.abs(stands) > _HOT_SIGMAS * np.maximum(np.sqrt(np.diag(noise)), _LEAST_SIGMA)
        # in every frame: where a telescope follows its object stars pass, and are gone when it is there
        hot &= (residual * np.sign(stands) > 0.5 * np.abs(stands)).all(axis=0)
        mean = np.where(hot, mean, smooth) if len(frames) > 2 else smooth
    noise = noise * _alike(residual, known)
    mean = mean + np.median(level, axis=0).astype(np.float32)
    return Sky(
        np.ascontiguousarray(mean, dtype=np.float32),
        noise + np.diag(np.maximum(0.25 - np.diag(noise), 0.0)),  # below half a count quantisation is the noise
        np.log(density),
        spec,
        cluttered_box(background.frames[-1], known),
    )


def _noise(residual: NDArray[np.float32]) -> NDArray[np.float64]:
    """(K, M, C) -> (C, C) covariance of what lies within four of the robust deviations.

    The median absolute deviation alone is a step function of the noise where counts are whole numbers: up to a
    fifth off at two counts.
    """
    robust = 1.4826 * np.median(np.abs(residual), axis=(0, 1))
    inside = np.abs(residual) <= 4 * np.maximum(robust, 0.5)
    seen = np.where(inside, residual, 0.0).reshape(-1, residual.shape[2]).astype(np.float64)
    both = inside.reshape(seen.shape).astype(np.float64)
    return np.asarray(seen.T @ seen / np.maximum(1.0, both.T @ both))


def _alike(residual: NDArray[np.float32], known: NDArray[np.bool_]) -> float:
    """Pixels whose noise is one: by how much the variance of squares' means exceeds that of white noise; 1 where chance
    may be the reason.

    Noise of enlarged, stacked or filtered images is alike in neighbours. As light is as smooth there, white noise that
    is as loud over a square says what such an image can tell. Differences of frames have no pattern of the sensor's.
    """
    changes = np.diff(residual, axis=0) if len(residual) > 1 else residual
    n, height, width, channels = changes.shape
    rows, columns = height // _SQUARE, width // _SQUARE
    shape = (n, rows, _SQUARE, columns, _SQUARE, channels)
    squares = changes[:, : rows * _SQUARE, : columns * _SQUARE].reshape(shape).mean(axis=(2, 4))
    whole = known[: rows * _SQUARE, : columns * _SQUARE].reshape(shape[1:5]).all(axis=(1, 3))
    if not whole.any():
        return 1.0
    loud, white = np.trace(_noise(_SQUARE * squares[:, whole])), np.trace(_noise(changes[:, known]))
    chance = _CHANCE * np.sqrt(2 / (n * np.count_nonzero(whole)))
    return float(loud / white) if loud > (1 + chance) * white > 0 else 1.0


def _smooth_sky(mean: NDArray[np.float32]) -> NDArray[np.float32]:
    """Low-pass of one channel in which stars do not leak: outliers are replaced by the coarse level around them.

    The coarse level is an average without the outliers, which are known only once there is a coarse level: three
    rounds are enough.
    """
    sigma = max(2.0, min(mean.shape) / 40)
    overall = float(np.median(mean))
    sky = np.ones(mean.shape, dtype=np.float32)
    coarse = mean
    for _ in range(3):
        weight = cv2.GaussianBlur(sky, (0, 0), sigma) + 1e-3  # in the midst of a wide outlier: the overall level
        coarse = (cv2.GaussianBlur(mean * sky, (0, 0), sigma) + 1e-3 * overall) / weight
        deviation = np.abs(mean - coarse)
        sky = (deviation <= 4 * 1.4826 * np.median(deviation) + 1e-6).astype(np.float32)
    clean = np.where(sky > 0, mean, coarse)
    return np.asarray(cv2.GaussianBlur(clean.astype(np.float32), (0, 0), sigma / 2), dtype=np.float32)
