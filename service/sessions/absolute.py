"""A frame's absolute attitude: what is known of the pointing, and what it makes of the poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np

from service.attitude.absolute import absolute_quaternion, body_rate, camera_rate, covariance_in_gcrf
from service.attitude.camera import Site, towards
from service.attitude.pointing import CameraOrientation, Mount, Pointing, boresight, camera_orientation
from service.errors import InputError
from service.imaging.facts import FrameFacts
from service.inference.params import CameraParams
from service.inference.pose import conjugate, from_matrices, multiply, rotation_matrices
from service.inference.state import Array, PoseEstimate, Spread

FRAME = "GCRF"
_ARCSECONDS = 3600.0


@dataclass(frozen=True)
class View:
    """The camera at one frame."""

    camera: CameraOrientation
    centre_px: tuple[float, float]  # where the optical axis meets the image
    rate: Array | None = None  # (3,) rad/s of the camera against GCRF, in its own axes

    @property
    def quaternion(self) -> Array:
        """(4,) camera -> GCRF."""
        return from_matrices(self.camera.to_gcrf)


@dataclass(frozen=True)
class Aim:
    """Where the camera looks, known without its rotation."""

    axis: Array  # (3,) GCRF unit vector
    field_deg: float | None  # from the middle of the image to its corner; None: the pixel scale is not known


def mount_of(params: CameraParams) -> Mount:
    """The session's camera as the attitude's arithmetic takes it."""
    site = None
    if params.site_latitude_deg is not None and params.site_longitude_deg is not None:
        site = Site(params.site_latitude_deg, params.site_longitude_deg, params.site_height_m)
    scale = params.pixel_scale_arcsec
    return Mount(
        kind=params.mount,
        up_angle_deg=params.up_angle_deg,
        mirrored=params.mirrored,
        equinox=params.equinox,
        pixel_scale_deg=None if scale is None else scale / _ARCSECONDS,
        pinhole=params.perspective is not None,
        site=site,
    )


def pointing_of(query: Mapping[str, Any], facts: FrameFacts) -> Pointing:
    """What is known of a frame's pointing: the query, and what the file says where the query is silent.

    A direction in the query replaces the file's whole direction; its rotation may still come from the file.
    """
    told = any(name in query for name in ("ra_deg", "dec_deg", "az_deg", "el_deg"))
    angle = query.get("position_angle_deg")
    return Pointing(
        ra_deg=query.get("ra_deg") if told else facts.ra_deg,
        dec_deg=query.get("dec_deg") if told else facts.dec_deg,
        azimuth_deg=query.get("az_deg"),
        elevation_deg=query.get("el_deg"),
        position_angle_deg=facts.position_angle_deg if angle is None else angle,
        mirrored=facts.mirrored,
        equinox=None if told else facts.equinox,
        pixel_scale_deg=facts.pixel_scale_deg,
    )


def view_of(
    pointing: Pointing, mount: Mount, moment: datetime, *, time_known: bool, size: tuple[int, int]
) -> View | None:
    """The camera, or None where it is not known. ``size`` is the image's width and height in pixels.

    Raises ``InputError`` where the time is needed and not known: the Earth turns by 15 arcseconds in a second.
    """
    camera = camera_orientation(pointing, mount, moment)
    if camera is None:
        return None
    if camera.earth is not None and not time_known:
        raise InputError("azimuth, elevation and an altaz mount need the frame's time", field="query:time")
    return View(camera, (size[0] / 2, size[1] / 2))


def aim_of(pointing: Pointing, mount: Mount, moment: datetime, size: tuple[int, int]) -> Aim | None:
    """Where the camera looks, or None where nobody told. ``size`` as of ``view_of``. Raises ``InputError``."""
    axis = boresight(pointing, mount, moment)
    if axis is None:
        return None
    scale = mount.pixel_scale_deg if pointing.pixel_scale_deg is None else pointing.pixel_scale_deg
    return Aim(axis, None if scale is None else scale * float(np.hypot(*size)) / 2)


def rate_since(before: Array, now: Array, dt_s: float) -> Array | None:
    """(3,) rad/s between two camera quaternions (4,), in axes of the later; None without time between them."""
    return camera_rate(rotation_matrices(before), rotation_matrices(now), dt_s) if dt_s > 0 else None


def attitude_document(view: View, pose: PoseEstimate, spread: Spread | None) -> dict[str, Any]:
    """``attitude`` of a pose as the API answers it; with ``spread``, its covariance."""
    axes = view.camera.to_gcrf
    scale = view.camera.pixel_scale_deg
    if scale is not None and not view.camera.pinhole:
        right, down = (pose.position - np.array(view.centre_px)) * scale
        axes = towards(axes, float(right), float(down), mirrored=view.camera.mirrored)
    quaternion = absolute_quaternion(axes, pose.quaternion)
    document: dict[str, Any] = {"frame": FRAME, "orientation": named(quaternion)}
    if pose.rotation_rate is not None and view.rate is not None:
        rate = np.rad2deg(body_rate(pose.quaternion, pose.rotation_rate, view.rate))
        document["angular_velocity_body_deg_s"] = rate.tolist()
        document["angular_velocity_gcrf_deg_s"] = (rotation_matrices(quaternion) @ rate).tolist()
    if spread is not None:
        about_body = spread.covariance[:3, :3]
        document["covariance_body_deg2"] = about_body.tolist()
        document["covariance_gcrf_deg2"] = covariance_in_gcrf(quaternion, about_body).tolist()
    return document


def camera_document(view: View) -> dict[str, Any]:
    """``camera`` of an estimate as the API answers it."""
    earth = view.camera.earth
    return {
        "frame": FRAME,
        "orientation": named(view.quaternion),
        "mirrored": view.camera.mirrored,
        "earth_orientation": None
        if earth is None
        else {"known": earth.known, "age_days": earth.age_days, "ut1_utc_s": earth.ut1_utc_s},
    }


def camera_quaternion(estimate: Mapping[str, Any]) -> Array | None:
    """(4,) camera -> GCRF out of an estimate, or None."""
    camera = estimate.get("camera")
    return None if camera is None else np.array([camera["orientation"][axis] for axis in "wxyz"])


def absolute_camera(estimate: Mapping[str, Any]) -> Array | None:
    """(4,) camera -> GCRF out of an estimate, turned towards where in the image the object was; None: not known."""
    attitude = estimate["best"]["attitude"]
    if attitude is None:
        return None
    body, seen = (np.array([one["orientation"][axis] for axis in "wxyz"]) for one in (attitude, estimate["best"]))
    return multiply(body, conjugate(seen))


def named(quaternion: Array) -> dict[str, float]:
    """(4,) as the wire has it."""
    return dict(zip("wxyz", quaternion.tolist(), strict=True))
