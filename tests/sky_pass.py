"""A pass over a real site with a known inertial attitude: astropy's sky and a pinhole camera, nothing of ours."""

import astropy.units as u
import numpy as np
from astropy.coordinates import AltAz, EarthLocation, SkyCoord
from astropy.time import Time

SITES = {"vienna": (48.23, 16.34), "paranal": (-24.63, -70.40)}
UP_DEG = 17.0
DISTANCE = 1e5  # of the object in its own units: perspective shows in the ray to it, not in its shape


def sky_camera(kind: str, site: str, moment, azimuth: float, elevation: float):
    """Unit vectors forward and up of the image in ICRS, and the centre's position, by astropy alone.

    The image's up lies ``UP_DEG`` from north (``equatorial``) or from the zenith (``altaz``), north through east.
    """
    latitude, longitude = SITES[site]
    frame = AltAz(obstime=Time(moment), location=EarthLocation.from_geodetic(longitude, latitude, 500))
    looked = SkyCoord(azimuth * u.deg, elevation * u.deg, frame=frame)
    centre = looked.icrs
    if kind == "altaz":
        above = looked.directional_offset_by(-UP_DEG * u.deg, 1e-3 * u.deg).icrs
    else:
        above = centre.directional_offset_by(UP_DEG * u.deg, 1e-3 * u.deg)
    forward, upward = (point.cartesian.xyz.value for point in (centre, above))
    up = upward - (upward @ forward) * forward
    return forward, up / np.linalg.norm(up), centre


def image_of(points, forward, up, mirrored: bool, size, pixel_deg: float, offset_deg=(0.06, 0.05)) -> np.ndarray:
    """Pinhole images (N, 2), pixels, of points (N, 3) about an object far away along a ray off the axis."""
    right = np.cross(forward, up)
    ray = forward + np.tan(np.deg2rad(offset_deg[0])) * right + np.tan(np.deg2rad(offset_deg[1])) * up
    seen = points + DISTANCE * ray / np.linalg.norm(ray)
    x, y = seen @ right / (seen @ forward), -(seen @ up) / (seen @ forward)
    flat = np.rad2deg(np.stack([-x if mirrored else x, y], axis=1)) / pixel_deg
    return flat + np.array(size) / 2


def affine_rows(points, image) -> tuple[np.ndarray, float]:
    """(3, 3) rotation and scale of the affine pose that fits the images of centred points best."""
    rows = np.linalg.lstsq(points, image - image.mean(axis=0), rcond=None)[0].T
    left, size, right = np.linalg.svd(rows, full_matrices=False)
    rows = left @ right
    return np.vstack([rows, np.cross(*rows)]), float(size.mean())
