"""Between a session's window (``service.imaging.window``), where the filter works, and the whole frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.imaging.window import Window, window_of
from service.inference.model.drawing import Lens
from service.inference.params import CameraParams, SessionConfig
from service.inference.smoothed import SmoothedEstimate
from service.inference.state import Estimate, Mode, PoseEstimate, Spread

_X, _Y = 3, 4  # rows of x and y in a covariance


def camera_window(camera: CameraParams, width: int, height: int) -> Window:
    """The session's window on frames of a size. Raises ``ConfigError``."""
    return window_of(width, height, camera.roi, camera.binning)


def in_window(config: SessionConfig) -> SessionConfig:
    """The configuration with its lengths in the image in binned pixels."""
    camera = config.camera
    if camera.binning == 1 or camera.psf_sigma_px is None:
        return config
    return replace(config, camera=replace(camera, psf_sigma_px=camera.psf_sigma_px / camera.binning))


def lens_of(camera: CameraParams, width: int, height: int, *, whole: bool = False) -> Lens | None:
    """The pinhole camera of frames of a size, in pixels of the window; None: weak perspective.

    ``whole``: in those of the whole frame.
    """
    if camera.perspective is None:
        return None
    x, y = camera.principal_point or (width / 2, height / 2)
    if whole:
        return Lens(camera.perspective, (x, y))
    (left, top), b = camera.origin_px, camera.binning
    return Lens(camera.perspective / b, ((x - left) / b, (y - top) / b))


def scale_in_window(scale_px: tuple[float, float] | None, camera: CameraParams) -> tuple[float, float] | None:
    """Bounds of the scale in binned pixels."""
    return None if scale_px is None else (scale_px[0] / camera.binning, scale_px[1] / camera.binning)


def in_full_frame(estimate: Estimate, camera: CameraParams) -> Estimate:
    """An estimate with its places and scales in pixels of the whole frame."""
    if is_whole(camera):
        return estimate
    return replace(
        estimate,
        mean=_pose(estimate.mean, camera),
        best=_pose(estimate.best, camera),
        spread=_spread(estimate.spread, camera),
        modes=tuple(_mode(mode, camera) for mode in estimate.modes),
        spread_all=None if estimate.spread_all is None else _spread(estimate.spread_all, camera),
        light_scale=None if estimate.light_scale is None else estimate.light_scale * camera.binning,
    )


def smoothed_in_full_frame(estimate: SmoothedEstimate, camera: CameraParams) -> SmoothedEstimate:
    """The same of a smoothed estimate."""
    if is_whole(camera):
        return estimate
    return replace(
        estimate,
        mean=_pose(estimate.mean, camera),
        best=_pose(estimate.best, camera),
        spread=_spread(estimate.spread, camera),
        modes=tuple(_mode(mode, camera) for mode in estimate.modes),
    )


def is_whole(camera: CameraParams) -> bool:
    """Whether the window's pixels are the frame's."""
    return camera.roi is None and camera.binning == 1


def _mode(mode: Mode, camera: CameraParams) -> Mode:
    return replace(mode, pose=_pose(mode.pose, camera), spread=_spread(mode.spread, camera))


def _pose(pose: PoseEstimate, camera: CameraParams) -> PoseEstimate:
    position = pose.position * camera.binning + camera.origin_px
    return replace(pose, position=position, scale=pose.scale * camera.binning)


def _spread(spread: Spread, camera: CameraParams) -> Spread:
    b = float(camera.binning)
    units = np.ones(len(spread.covariance))
    units[[_X, _Y]] = b  # the scale is there as its logarithm
    return replace(
        spread,
        x_px=b * spread.x_px,
        y_px=b * spread.y_px,
        scale_px=b * spread.scale_px,
        covariance=spread.covariance * np.outer(units, units),
    )
