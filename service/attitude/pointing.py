"""From what is known of a telescope's pointing to the orientation of its camera."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Literal

import numpy as np

from service.attitude.camera import Site, camera_axes, direction, horizontal_direction, zenith
from service.attitude.earth import EarthOrientation, earth_orientation, of_date_to_gcrf
from service.errors import InputError
from service.inference.state import Array

Equinox = Literal["J2000", "date"]
CELESTIAL_POLE = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Mount:
    """What stays the same over a pass."""

    kind: Literal["equatorial", "altaz"] = "equatorial"
    up_angle_deg: float | None = None
    """From north (equatorial) or from the zenith (altaz) to the image's up, in the sense north through east."""
    mirrored: bool = False
    equinox: Equinox = "J2000"
    pixel_scale_deg: float | None = None
    pinhole: bool = False
    """Poses are relative to the optical axis, not to the ray to the object."""
    site: Site | None = None


@dataclass(frozen=True)
class Pointing:
    """What is known of one frame; None is unknown. Azimuth and elevation go before right ascension and declination."""

    ra_deg: float | None = None
    dec_deg: float | None = None
    azimuth_deg: float | None = None
    elevation_deg: float | None = None
    position_angle_deg: float | None = None
    mirrored: bool | None = None
    equinox: Equinox | None = None
    pixel_scale_deg: float | None = None


@dataclass(frozen=True)
class CameraOrientation:
    """The camera among the stars at one moment."""

    to_gcrf: Array  # (3, 3) rotation of camera axes (x right, y down) to GCRF
    mirrored: bool
    pixel_scale_deg: float | None
    earth: EarthOrientation | None  # where it was used
    pinhole: bool = False  # poses are relative to the optical axis


def camera_orientation(pointing: Pointing, mount: Mount, moment: datetime) -> CameraOrientation | None:
    """The camera's orientation, or None where direction or rotation is unknown.

    Raises ``InputError`` for an azimuth without an elevation or a site, and for half of an equatorial position.
    """
    mirrored = mount.mirrored if pointing.mirrored is None else pointing.mirrored
    scale = mount.pixel_scale_deg if pointing.pixel_scale_deg is None else pointing.pixel_scale_deg
    forward = boresight(pointing, mount, moment)
    if forward is None:
        return None
    turned = _sky_axes(pointing, mount, moment)
    if pointing.position_angle_deg is not None:
        pole, angle_deg, local = turned @ CELESTIAL_POLE, pointing.position_angle_deg, False
    elif mount.up_angle_deg is None:
        return None
    elif mount.kind == "altaz":
        pole, angle_deg, local = zenith(_site(mount), moment), mount.up_angle_deg, True
    else:
        pole, angle_deg, local = turned @ CELESTIAL_POLE, mount.up_angle_deg, False
    earth = earth_orientation(moment) if local or pointing.azimuth_deg is not None else None
    axes = camera_axes(forward, pole, angle_deg, mirrored=mirrored)
    return CameraOrientation(axes, mirrored, scale, earth, mount.pinhole)


def boresight(pointing: Pointing, mount: Mount, moment: datetime) -> Array | None:
    """(3,) GCRF unit vector of the direction that was told, or None. Raises ``InputError``."""
    _require_pair(pointing.ra_deg, pointing.dec_deg, "ra_deg", "dec_deg")
    _require_pair(pointing.azimuth_deg, pointing.elevation_deg, "az_deg", "el_deg")
    if pointing.azimuth_deg is not None and pointing.elevation_deg is not None:
        return horizontal_direction(pointing.azimuth_deg, pointing.elevation_deg, _site(mount), moment)
    if pointing.ra_deg is not None and pointing.dec_deg is not None:
        return _sky_axes(pointing, mount, moment) @ direction(pointing.ra_deg, pointing.dec_deg)
    return None


def _sky_axes(pointing: Pointing, mount: Mount, moment: datetime) -> Array:
    """(3, 3) from the equator and equinox that coordinates refer to, to GCRF."""
    equinox = pointing.equinox or mount.equinox
    return of_date_to_gcrf(moment) if equinox == "date" else np.eye(3)


def _site(mount: Mount) -> Site:
    if mount.site is None:
        raise InputError(
            "azimuth and elevation need the session's camera.site_latitude_deg and camera.site_longitude_deg",
            field="query:az_deg",
        )
    return mount.site


def _require_pair(first: float | None, second: float | None, first_name: str, second_name: str) -> None:
    if (first is None) != (second is None):
        missing = first_name if first is None else second_name
        raise InputError(f"{first_name} and {second_name} go together; {missing} is missing", field=f"query:{missing}")
