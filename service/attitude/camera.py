"""Orientation of the camera among the stars: the rotation from camera axes (x right, y down, z away) to GCRF.

Angles on the sky are counted as astronomers count them: from north through east, which is anticlockwise as seen
from inside the sphere. A mirrored image is handled by its own right-handed axes: x and y stay the image's right and
down, so that z comes towards the observer. A silhouette under the affine camera does not depend on depth, so the
filter's rotation holds in these axes as it does in the others, and nothing else needs to know of the mirror.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

import numpy as np

from service.attitude.earth import gcrf_to_itrf, of_date_to_gcrf, zenith_frame
from service.inference.state import Array


@dataclass(frozen=True)
class Site:
    """Geodetic place on the Earth (WGS 84). Its height turns nothing: only a range counts it."""

    latitude_deg: float
    longitude_deg: float  # east
    height_m: float = 0.0


def direction(longitude_deg: float, latitude_deg: float) -> Array:
    """(3,) unit vector of right ascension and declination."""
    longitude, latitude = np.deg2rad([longitude_deg, latitude_deg])
    return np.array(
        [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)], dtype=np.float64
    )


def horizontal_direction(azimuth_deg: float, elevation_deg: float, site: Site, moment: datetime) -> Array:
    """(3,) GCRF unit vector of an azimuth (from north through east) and elevation, without refraction."""
    azimuth, elevation = np.deg2rad([azimuth_deg, elevation_deg])
    east_north_up = np.array(
        [np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)]
    )
    fixed = zenith_frame(site.latitude_deg, site.longitude_deg) @ east_north_up
    return np.asarray(gcrf_to_itrf(moment).T @ fixed, dtype=np.float64)


def zenith(site: Site, moment: datetime) -> Array:
    """(3,) GCRF unit vector of the geodetic zenith."""
    return gcrf_to_itrf(moment).T @ zenith_frame(site.latitude_deg, site.longitude_deg)[:, 2]


def camera_axes(forward: Array, pole: Array, up_angle_deg: float, *, mirrored: bool = False) -> Array:
    """(3, 3) rotation from camera axes to those of the unit vectors ``forward`` and ``pole``.

    The image's up direction lies ``up_angle_deg`` from the direction to ``pole``, in the sense north through east
    where the pole is the celestial one. Undefined, and here some right angle, where ``forward`` is the pole itself.
    """
    north = pole - (pole @ forward) * forward
    if np.linalg.norm(north) < 1e-12:
        north = np.eye(3)[np.argmin(np.abs(forward))]
        north = north - (north @ forward) * forward
    north = north / np.linalg.norm(north)
    east = np.cross(north, forward)
    angle = np.deg2rad(up_angle_deg)
    up = np.cos(angle) * north + np.sin(angle) * east
    right = np.cross(forward, up)  # seen from inside the sphere, with north up, the west is on the right
    down = -up
    if mirrored:
        right = -right
    return np.column_stack([right, down, np.cross(right, down)])


def equatorial_camera(
    ra_deg: float, dec_deg: float, position_angle_deg: float, *, mirrored: bool = False, of_date: datetime | None = None
) -> Array:
    """(3, 3) rotation camera -> GCRF from right ascension, declination and the position angle of the image's up.

    ``of_date``: coordinates refer to the true equator and equinox of this moment instead of GCRF (J2000).
    """
    axes = camera_axes(direction(ra_deg, dec_deg), np.array([0.0, 0.0, 1.0]), position_angle_deg, mirrored=mirrored)
    return axes if of_date is None else of_date_to_gcrf(of_date) @ axes


def towards(camera: Array, right_deg: float, down_deg: float, *, mirrored: bool = False) -> Array:
    """(3, 3) the camera's axes, turned the shortest way to a ray so far to the right and down of its optical axis.

    A pose under weak perspective is relative to the ray to the object, not to the optical axis: at the edge of a field
    of one degree the difference is half a degree. Angles are those on the tangent plane.
    """
    away = -1.0 if mirrored else 1.0  # the z axis of a mirrored image comes towards the observer
    ray = np.array([away * np.tan(np.deg2rad(right_deg)), away * np.tan(np.deg2rad(down_deg)), 1.0])
    ray /= np.linalg.norm(ray)
    return camera @ _rotation(np.cross([0.0, 0.0, 1.0], ray), ray[2])


def _rotation(axis: Array, cosine: float) -> Array:
    """Rodrigues' formula for an ``axis`` as long as the sine of its angle: no division by a small sine."""
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]], dtype=np.float64)
    return np.eye(3) + cross + cross @ cross / (1.0 + cosine)
