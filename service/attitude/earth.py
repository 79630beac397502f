"""How the Earth is turned: IAU 2006/2000A precession-nutation and the Earth-orientation data that came installed.

Nothing is ever downloaded. The data (IERS A, package ``astropy-iers-data``) reach about a year past their issue
as predictions; outside of them UT1 = UTC is taken, which turns an azimuth by at most 14 arcseconds. Time scales
are ERFA's (``astropy`` is built on it), without the second that importing all of ``astropy.time`` takes.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

import astropy_iers_data
import erfa
import numpy as np

from service.inference.state import Array

_ARCSECOND = np.pi / 648_000
_MJD_ZERO = 2_400_000.5
_DAY_S = 86_400.0
_TT_TAI_S = 32.184
_EPOCH = datetime(1858, 11, 17, tzinfo=UTC)  # MJD 0


@dataclass(frozen=True)
class EarthOrientation:
    """UT1 - UTC and the pole at a moment, and how far past the newest measurement that is."""

    ut1_utc_s: float
    pole_x_rad: float
    pole_y_rad: float
    age_days: float
    """Days from the newest measured value to the moment; negative where the moment was measured."""
    known: bool
    """False outside of the data, where zeros stand in."""


def earth_orientation(moment: datetime) -> EarthOrientation:
    """Earth-orientation data for an aware ``moment``."""
    table = _table()
    mjd = _mjd(moment)
    age_days = mjd - table.last_measured_mjd
    if not table.mjd[0] <= mjd <= table.mjd[-1]:
        return EarthOrientation(0.0, 0.0, 0.0, age_days, known=False)
    # UT1 - TAI has no leap seconds to interpolate across.
    ut1_tai = np.interp(mjd, table.mjd, table.ut1_tai_s)
    return EarthOrientation(
        float(ut1_tai + _tai_utc_s(mjd)),
        float(np.interp(mjd, table.mjd, table.pole_x_rad)),
        float(np.interp(mjd, table.mjd, table.pole_y_rad)),
        age_days,
        known=True,
    )


def gcrf_to_itrf(moment: datetime) -> Array:
    """(3, 3) matrix from GCRF to Earth-fixed (ITRF) coordinates: ERFA ``c2t06a``."""
    found = earth_orientation(moment)
    mjd = _mjd(moment)
    ut1 = mjd + found.ut1_utc_s / _DAY_S
    matrix = erfa.c2t06a(_MJD_ZERO, _terrestrial_mjd(mjd), _MJD_ZERO, ut1, found.pole_x_rad, found.pole_y_rad)
    return np.asarray(matrix, dtype=np.float64)


def terrestrial_mjd(moment: datetime) -> float:
    """Modified Julian date in TT of an aware ``moment``."""
    return _terrestrial_mjd(_mjd(moment))


def of_date_to_gcrf(moment: datetime) -> Array:
    """(3, 3) matrix from the true equator and equinox of date to GCRF: the transpose of ERFA ``pnm06a``."""
    return np.asarray(erfa.pnm06a(_MJD_ZERO, terrestrial_mjd(moment)), dtype=np.float64).T


def zenith_frame(latitude_deg: float, longitude_deg: float) -> Array:
    """(3, 3): columns are east, north and up at a geodetic place, in ITRF coordinates."""
    (sin_lat, sin_lon) = np.sin(np.deg2rad([latitude_deg, longitude_deg]))
    (cos_lat, cos_lon) = np.cos(np.deg2rad([latitude_deg, longitude_deg]))
    east = [-sin_lon, cos_lon, 0.0]
    north = [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat]
    up = [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat]
    return np.array([east, north, up], dtype=np.float64).T


@dataclass(frozen=True)
class _Table:
    mjd: Array
    ut1_tai_s: Array
    pole_x_rad: Array
    pole_y_rad: Array
    last_measured_mjd: float


@cache
def _table() -> _Table:
    """The file ``finals2000A.all``: fixed columns, as its ``readme.finals2000A`` numbers them (from 1)."""
    rows = []
    for line in Path(astropy_iers_data.IERS_A_FILE).read_text(encoding="ascii").splitlines():
        if line[58:68].strip():  # the last rows are dates without values
            pole_and_time = (line[7:15], line[18:27], line[37:46], line[58:68])
            rows.append([float(text) for text in pole_and_time] + [line[57] == "I"])
    mjd, pole_x, pole_y, ut1_utc, measured = np.array(rows, dtype=np.float64).T
    return _Table(
        mjd,
        ut1_utc - np.array([_tai_utc_s(day) for day in mjd]),
        pole_x * _ARCSECOND,
        pole_y * _ARCSECOND,
        float(mjd[measured > 0][-1]),
    )


@cache
def _leap_seconds() -> tuple[Array, Array]:
    """MJD from which on TAI - UTC has each of its values, and these values."""
    table = erfa.leap_seconds.get()
    starts = [datetime(year, month, 1, tzinfo=UTC) for year, month in zip(table["year"], table["month"], strict=True)]
    return np.array([_mjd(start) for start in starts]), np.asarray(table["tai_utc"], dtype=np.float64)


def _tai_utc_s(mjd: float) -> float:
    starts, values = _leap_seconds()
    return float(values[max(int(np.searchsorted(starts, mjd, side="right")) - 1, 0)])


def _terrestrial_mjd(mjd: float) -> float:
    return mjd + (_tai_utc_s(mjd) + _TT_TAI_S) / _DAY_S


def _mjd(moment: datetime) -> float:
    """Modified Julian date of an aware moment; UTC days of 86,400 s."""
    return (moment - _EPOCH).total_seconds() / _DAY_S
