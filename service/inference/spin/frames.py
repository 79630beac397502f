"""What each frame of a pass says of the orientation by itself: a mixture over rotations (docs/motion.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import lgamma, log, pi

import numpy as np
from numpy.typing import NDArray

from service.inference.model.prior import POSE_DEGREES_OF_FREEDOM
from service.inference.pose import conjugate, log_so3, multiply
from service.inference.state import Array, Poses
from service.inference.symmetry import Symmetry, twin

LEAST_SIGMA_RAD = 1e-5  # numerical: so that a covariance can be inverted
DEGREES = POSE_DEGREES_OF_FREEDOM
# exact: of the Student t of three axes
LOG_HEIGHT = lgamma((DEGREES + 3) / 2) - lgamma(DEGREES / 2) - 1.5 * log(DEGREES * pi)
LOG_UNIFORM = -log(8 * pi**2)  # exact: of a rotation that may be any, per rad^3


@dataclass(frozen=True)
class PassFrames:
    """n frames in order of time, each with up to M modes; what is missing has the log weight -inf.

    A frame's likelihood of a rotation q is sum_m w_m t(log(q_m^-1 q); C_m), Student t's of
    ``POSE_DEGREES_OF_FREEDOM`` in body-side tangents, the weights w_m of sum 1.
    """

    time_s: Array  # (n,)
    quaternion: Array  # (n, M, 4) body -> fixed frame
    root: Array  # (n, M, 3, 3) symmetric W with W W = C^-1, 1/rad
    log_weight: Array  # (n, M)
    n_starts: int  # of the M, the first ones: the others are only their symmetry-equivalents
    station: NDArray[np.intp]  # (n,) number of the telescope: frames of two err independently

    def __len__(self) -> int:
        return len(self.time_s)

    def __getitem__(self, index: NDArray[np.intp] | NDArray[np.bool_]) -> PassFrames:
        return PassFrames(
            self.time_s[index],
            self.quaternion[index],
            self.root[index],
            self.log_weight[index],
            self.n_starts,
            self.station[index],
        )


def pass_frames(
    time_s: Array,
    quaternions: Sequence[Array],
    covariances: Sequence[Array],
    weights: Sequence[Array],
) -> PassFrames:
    """Of n frames in order of time: (m, 4) modes, (m, 3, 3) scales of their Student t's (rad^2), (m,) weights each."""
    most = max(len(w) for w in weights)
    quaternion = np.tile([1.0, 0.0, 0.0, 0.0], (len(time_s), most, 1))
    root = np.tile(np.eye(3), (len(time_s), most, 1, 1))
    log_weight = np.full((len(time_s), most), -np.inf)
    for k, (q, c, w) in enumerate(zip(quaternions, covariances, weights, strict=True)):
        quaternion[k, : len(w)] = q
        values, vectors = np.linalg.eigh(c)
        scale = np.maximum(values, LEAST_SIGMA_RAD**2) ** -0.5
        root[k, : len(w)] = np.einsum("mij,mj,mkj->mik", vectors, scale, vectors)
        with np.errstate(divide="ignore"):
            log_weight[k, : len(w)] = np.log(np.asarray(w) / np.sum(w))
    one = np.zeros(len(time_s), dtype=np.intp)
    return PassFrames(np.asarray(time_s, np.float64), quaternion, root, log_weight, most, one)


def merged(stations: Sequence[PassFrames]) -> tuple[PassFrames, NDArray[np.intp]]:
    """Frames of several telescopes, body -> one fixed frame, in order of time; and where each was among all of them."""
    starts, count = max(one.n_starts for one in stations), sum(len(one) for one in stations)
    others = max(one.log_weight.shape[1] - one.n_starts for one in stations)
    quaternion = np.tile([1.0, 0.0, 0.0, 0.0], (count, starts + others, 1))
    root = np.tile(np.eye(3), (count, starts + others, 1, 1))
    log_weight = np.full((count, starts + others), -np.inf)
    first = 0
    for one in stations:
        rows = slice(first, first + len(one))
        for to, own in (
            (slice(0, one.n_starts), slice(0, one.n_starts)),
            (slice(starts, starts + one.log_weight.shape[1] - one.n_starts), slice(one.n_starts, None)),
        ):
            quaternion[rows, to], root[rows, to] = one.quaternion[:, own], one.root[:, own]
            log_weight[rows, to] = one.log_weight[:, own]
        first += len(one)
    time_s = np.concatenate([one.time_s for one in stations])
    station = np.repeat(np.arange(len(stations)), [len(one) for one in stations])
    order = np.argsort(time_s, kind="stable")
    return PassFrames(time_s, quaternion, root, log_weight, starts, station)[order], order


def with_equivalents(frames: PassFrames, symmetries: Sequence[Symmetry]) -> PassFrames:
    """Frames of rotations body -> camera, every mode also as the body's symmetry-equivalents show it.

    Those of a mirror turn otherwise than what they mirror, so candidates begin at them, too.
    """
    symmetries = sorted(symmetries, key=lambda one: one.kind != "mirror")
    starts = frames.n_starts * (1 + sum(one.kind == "mirror" for one in symmetries))
    copies = [frames]
    shape = frames.log_weight.shape
    flat = frames.quaternion.reshape(-1, 4)
    anywhere = Poses(flat, np.zeros((len(flat), 2)), np.zeros(len(flat)), np.zeros((len(flat), 0)))
    for symmetry in symmetries:
        matrix = np.asarray(symmetry.matrix)
        turned = np.einsum("ij,nmjk,lk->nmil", matrix, frames.root, matrix)
        quaternion = twin(anywhere, symmetry).quaternion.reshape(*shape, 4)
        copies.append(replace(frames, quaternion=quaternion, root=turned))
    return replace(
        frames,
        quaternion=np.concatenate([one.quaternion for one in copies], axis=1),
        root=np.concatenate([one.root for one in copies], axis=1),
        log_weight=np.concatenate([one.log_weight for one in copies], axis=1) - np.log(len(copies)),
        n_starts=starts,
    )


def seen_from(frames: PassFrames, cameras: Array) -> PassFrames:
    """Frames of rotations body -> camera as body -> fixed, with each frame's camera -> fixed (n, 4)."""
    return replace(frames, quaternion=multiply(cameras[:, None], frames.quaternion))


def gaps(frames: PassFrames, q: Array) -> Array:
    """(B, n, M, 3) whitened tangents W log(q_m^-1 q) of orientations (B, n, 4)."""
    away = log_so3(multiply(conjugate(frames.quaternion), q[:, :, None]))
    return np.asarray(np.einsum("nmij,bnmj->bnmi", frames.root, away))


def log_densities(frames: PassFrames, squares: Array) -> Array:
    """(B, n, M) log of w_m t(...) at squared whitened distances (B, n, M), per rad^3."""
    heights = frames.log_weight + np.linalg.slogdet(frames.root)[1] + LOG_HEIGHT
    return np.asarray(heights - 0.5 * (DEGREES + 3) * np.log1p(squares / DEGREES))
