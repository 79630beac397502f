"""Background and particles of a checkpoint: held against everything that the tracker will take for granted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.errors import CheckpointError
from service.imaging.background import Background
from service.inference.state import STATUSES, FilterState
from service.workers.base import RestoreJob, RestoreReport
from service.workers.codec import decode
from service.workers.full_frame import camera_window
from service.workers.restored_mixture import check_clutter, check_mixture

_LARGEST = 1e9  # px, degrees, seconds, units: whatever is larger is no state of a track
_UNIT = 1e-6  # how far a quaternion's length, or a sum of weights, may be from 1


def check_restored(job: RestoreJob) -> RestoreReport:
    """What the background and the particles are. Raises ``CheckpointError`` for what is neither."""
    try:
        report = RestoreReport()
        if job.background is not None and job.size is not None:
            background = Background.from_bytes(job.background)
            background.require(job.config.likelihood.feature, job.config.likelihood.gradient_sigma_px)
            height, width, channels = background.shape
            if camera_window(job.config.camera, *job.size).size != (width, height):
                raise ValueError(f"the background is {width} x {height}")
            report = RestoreReport(background.n_frames, channels, background.bits)
        if job.state is None:
            return report
        state = decode(FilterState, job.state)
        check_state(state, job.n_joints, resampled=job.config.filter.method == "bootstrap")
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise CheckpointError(f"the content does not fit: {error}", field="body") from error
    return replace(report, frame_index=state.frame_index, time_s=state.time_s, status=state.status)


def check_state(state: FilterState, n_joints: int, *, resampled: bool = True) -> None:
    """Raises ``ValueError`` where the particles are no posterior of a session with so many free joints.

    ``resampled``: the next frame goes on from them; else they may be as ``FilterState.to_show`` leaves them.
    """
    poses, n = state.poses, len(state.log_weights)
    with_rates = n if resampled or len(state.rates) else 0
    kinds = (np.float64,) if resampled else (np.float64, np.float32)
    shapes = {
        "quaternion": (poses.quaternion, (n, 4)),
        "position": (poses.position, (n, 2)),
        "log_scale": (poses.log_scale, (n,)),
        "joints": (poses.joints, (n, n_joints)),
        "log_weights": (state.log_weights, (n,)),
        "rates": (state.rates, (with_rates, 6 + n_joints)),
    }
    for name, (array, shape) in shapes.items():
        if array.shape != shape or array.dtype not in kinds or n < 1:
            raise ValueError(f"{name} is {array.dtype} {array.shape}, not {kinds[-1].__name__} {shape}")
        most = 50.0 if name == "log_scale" else _LARGEST
        if not ((np.abs(array) <= most) | (np.isneginf(array) if name == "log_weights" else False)).all():
            raise ValueError(f"{name} is not finite, or too large")
    if np.abs(np.linalg.norm(poses.quaternion, axis=1) - 1).max() > _UNIT:
        raise ValueError("a quaternion is not of length 1")
    if abs(float(np.exp(state.log_weights).sum()) - 1) > _UNIT:
        raise ValueError("the weights do not sum to 1")
    if type(state.frame_index) is not int or type(state.time_s) is not float or not np.isfinite(state.time_s):
        raise ValueError("the state's frame or time is no number")
    if state.status not in STATUSES:
        raise ValueError(f"status {state.status!r}")
    _check_memory(state.memory)
    if state.mixture is not None:
        check_mixture(state.mixture, n_joints)
    if state.clutter is not None:
        check_clutter(state.clutter)


def _check_memory(memory: Mapping[str, NDArray[np.generic]]) -> None:
    """What an earlier version's filter remembered: nothing uses it, and it must be small."""
    for name, array in memory.items():
        if array.size > 1 << 20 or not np.isfinite(array).all():
            raise ValueError(f"memory {name!r} is no finite array, or too large")
    if len(memory) > _MOST_NAMES:
        raise ValueError("the memory has too many names")


_MOST_NAMES = 64
