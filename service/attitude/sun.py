"""Where the Sun stands: its apparent place in GCRF, and its direction in the axes of a camera.

ERFA's ``epv00`` (the Earth about the Sun, VSOP2000 cut to a tenth of an arcsecond) with the Earth's aberration. Nothing
is downloaded. The direction is that from the Earth's centre: from a satellite at 1,000 km it is 0.003 degrees another.
"""

from __future__ import annotations

from datetime import datetime

import erfa
import numpy as np

from service.attitude.earth import terrestrial_mjd
from service.attitude.pointing import CameraOrientation
from service.errors import InputError
from service.inference.state import Array

AU_KM = 149_597_870.7
_LIGHT_AU_PER_DAY = 173.144_632_684_669_3
_MJD_ZERO = 2_400_000.5
_J2000_MJD, _CENTURY_DAYS = 51_544.5, 36_525.0


def sun_from_earth(moment: datetime) -> Array:
    """(3,) km, GCRF: the Sun as it is seen from the Earth's centre at an aware ``moment``.

    TT stands for TDB (2 ms apart). The deflection of light and the Sun's own way in eight minutes, 0.01 arcseconds, are
    left out. Raises ``InputError`` outside of 1900 to 2100, where the ephemeris does not hold.
    """
    mjd = terrestrial_mjd(moment)
    if abs(mjd - _J2000_MJD) > _CENTURY_DAYS:
        raise InputError("the Sun's place is known from 1900 to 2100 only", field="query:time")
    about_sun, about_barycentre = erfa.epv00(_MJD_ZERO, mjd)
    offset = -np.asarray(about_sun["p"], dtype=np.float64)
    distance = float(np.linalg.norm(offset))
    velocity = np.asarray(about_barycentre["v"], dtype=np.float64) / _LIGHT_AU_PER_DAY
    seen = erfa.ab(offset / distance, velocity, distance, np.sqrt(1.0 - velocity @ velocity))
    return np.asarray(seen, dtype=np.float64) * distance * AU_KM


def in_camera(direction: Array, camera: CameraOrientation) -> Array:
    """(3,) unit vector of a GCRF ``direction``, in x right, y down, z away from the camera.

    So it is also of a mirrored image, whose poses count z towards the observer (``service.attitude.camera``).
    """
    seen = camera.to_gcrf.T @ (direction / np.linalg.norm(direction))
    return np.asarray(seen * (1.0, 1.0, -1.0 if camera.mirrored else 1.0), dtype=np.float64)


def phase_angle_deg(towards_sun: Array) -> float:
    """Angle Sun-object-observer of a direction to the Sun in camera axes (3,): 0 is full light."""
    x, y, z = towards_sun
    return float(np.rad2deg(np.arctan2(np.hypot(x, y), -z)))  # the observer is in the direction (0, 0, -1)
