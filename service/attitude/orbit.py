"""Where a satellite stands in the sky of a site: mean elements (TLE or OMM) through SGP4.

SGP4 answers in TEME (true equator, mean equinox of date); Greenwich mean sidereal time (IAU 1982) takes that to
Earth-fixed axes, as Vallado et al., *Revisiting Spacetrack Report #3* (AIAA 2006-6753), appendix C, have it. Polar
motion, ten metres at most, is left out.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

import erfa
import numpy as np
from defusedxml.ElementTree import fromstring
from sgp4 import omm
from sgp4.api import SGP4_ERRORS, Satrec
from sgp4.earth_gravity import wgs72
from sgp4.io import compute_checksum, twoline2rv

from service.attitude.camera import Site
from service.attitude.earth import EarthOrientation, earth_orientation, gcrf_to_itrf, zenith_frame
from service.errors import ConfigError, InputError
from service.inference.state import Array

_JD_EPOCH = 2_440_587.5  # 1970-01-01
_DAY_S = 86_400.0
_WGS84 = 1  # ERFA's number of the ellipsoid
_TLE_FIELDS = {
    1: (("epoch", 19, 32), ("change of the mean motion", 34, 43)),
    2: (
        ("inclination", 9, 16),
        ("ascending node", 18, 25),
        ("eccentricity", 27, 33),
        ("argument of perigee", 35, 42),
        ("mean anomaly", 44, 51),
        ("mean motion", 53, 63),
    ),
}
"""Numbers of a TLE, columns counted from 1."""
_OMM_FIELDS = (
    "EPOCH",
    "MEAN_MOTION",
    "ECCENTRICITY",
    "INCLINATION",
    "RA_OF_ASC_NODE",
    "ARG_OF_PERICENTER",
    "MEAN_ANOMALY",
)
"""That it must have; the others have defaults."""
_OMM_DEFAULTS = {
    "CLASSIFICATION_TYPE": "U",
    "OBJECT_ID": "",
    "EPHEMERIS_TYPE": 0,
    "ELEMENT_SET_NO": 0,
    "REV_AT_EPOCH": 0,
    "NORAD_CAT_ID": 0,
    "BSTAR": 0.0,
    "MEAN_MOTION_DOT": 0.0,
    "MEAN_MOTION_DDOT": 0.0,
}


@dataclass(frozen=True)
class Sighting:
    """The satellite seen from a site at a moment."""

    range_km: float
    azimuth_deg: float  # from north through east
    elevation_deg: float  # without refraction
    elements_age_days: float  # from the epoch of the elements to the moment; negative before it
    earth: EarthOrientation
    place_km: tuple[float, float, float]  # from the Earth's centre, GCRF


class Orbit:
    """Mean elements of one satellite."""

    def __init__(self, text: str) -> None:
        """``text``: a TLE of two lines, or three with a name; an OMM as JSON, XML or KVN. Raises ``ConfigError``."""
        try:
            self._satellite = _read(text.strip())
        except (KeyError, ValueError, TypeError, IndexError, AttributeError, SyntaxError) as error:
            raise _unreadable(str(error)) from error
        if self._satellite.error:
            raise ConfigError(_reason(self._satellite.error), field="prior.orbit")
        epoch_days = self._satellite.jdsatepoch - _JD_EPOCH + self._satellite.jdsatepochF
        self.epoch = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(days=epoch_days)

    def seen_from(self, site: Site, moment: datetime) -> Sighting:
        """The satellite at an aware ``moment``. Raises ``InputError`` where SGP4 has no answer."""
        earth = earth_orientation(moment)
        fixed = self.fixed_km(moment, earth)
        offset = fixed - _site_km(site)
        east, north, up = zenith_frame(site.latitude_deg, site.longitude_deg).T @ offset
        distance = float(np.linalg.norm(offset))
        x, y, z = (gcrf_to_itrf(moment).T @ fixed).tolist()
        return Sighting(
            range_km=distance,
            azimuth_deg=float(np.rad2deg(np.arctan2(east, north)) % 360),
            elevation_deg=float(np.rad2deg(np.arcsin(up / distance))),
            elements_age_days=(moment - self.epoch).total_seconds() / _DAY_S,
            earth=earth,
            place_km=(x, y, z),
        )

    def fixed_km(self, moment: datetime, earth: EarthOrientation | None = None) -> Array:
        """(3,) from the Earth's centre in Earth-fixed axes. Raises ``InputError`` where SGP4 has no answer."""
        unix_days = (moment - datetime(1970, 1, 1, tzinfo=UTC)).total_seconds() / _DAY_S
        problem, teme_km, _ = self._satellite.sgp4(_JD_EPOCH, unix_days)
        if problem:
            raise InputError(f"the orbit has no place at this time: {_reason(problem)}", field="query:time")
        ut1_utc_s = (earth or earth_orientation(moment)).ut1_utc_s
        return np.asarray(_greenwich(unix_days + ut1_utc_s / _DAY_S) @ np.array(teme_km))


def check_sums(text: str) -> list[str]:
    """What to say of a TLE whose checksum (column 69: its digits and minus signs, modulo 10) is not that of its line.

    Those who write elements by hand seldom mend it, so it is told and nothing is refused. Lines may have none.
    """
    found = []
    for line in _tle(text.strip()):
        told, expected = line[68:69], compute_checksum(line)
        if told.isdigit() and int(told) != expected:
            found.append(
                f"prior.orbit: TLE line {line[0]}, checksum (column 69): {told!r}, but the line's digits make "
                f"{expected}: one of them may be mistyped"
            )
    return found


def _unreadable(why: str) -> ConfigError:
    return ConfigError(f"the orbit cannot be read: {why}", field="prior.orbit")


def _reason(problem: int) -> str:
    return str(SGP4_ERRORS.get(problem, f"SGP4 error {problem}"))


def _greenwich(ut1_days: float) -> Array:
    """(3, 3) TEME to Earth-fixed axes; ``ut1_days`` since 1970."""
    angle = erfa.gmst82(_JD_EPOCH, ut1_days)
    return np.asarray(erfa.rz(angle, np.eye(3)), dtype=np.float64)


def _site_km(site: Site) -> Array:
    place = erfa.gd2gc(_WGS84, np.deg2rad(site.longitude_deg), np.deg2rad(site.latitude_deg), site.height_m)
    return np.asarray(place, dtype=np.float64) / 1e3


def _read(text: str) -> Any:
    if text.startswith(("{", "[")):
        fields = json.loads(text)
        return _from_omm(fields[0] if isinstance(fields, list) and fields else fields)
    if text.startswith("<"):
        fromstring(text, forbid_dtd=True)  # refuses document types and entities, which the next would take
        return _from_omm(next(omm.parse_xml(io.StringIO(text)), {}))
    lines = _tle(text)
    if lines:
        _check_tle(lines)
        twoline2rv(lines[-2], lines[-1], wgs72)  # it checks the columns; the faster reader takes anything
        return Satrec.twoline2rv(lines[-2], lines[-1])
    pairs = [line.partition("=") for line in text.splitlines() if "=" in line]
    if not pairs:
        raise ValueError("it is neither a TLE (lines that begin with 1 and with 2) nor an OMM (JSON, XML or KVN)")
    return _from_omm({key.strip(): value.split("[")[0].strip() for key, _, value in pairs})


def _tle(text: str) -> list[str]:
    """The lines of what looks like a TLE: two, or three with a name; else none."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines if len(lines) <= 3 and any(line.startswith(("1 ", "2 ")) for line in lines) else []


def _check_tle(lines: Sequence[str]) -> None:
    """Raises ``ValueError`` that names the line and the field."""
    if len(lines) < 2 or not (lines[-2].startswith("1 ") and lines[-1].startswith("2 ")):
        raise ValueError("a TLE has a line that begins with 1 and then one that begins with 2")
    for number, line in ((1, lines[-2]), (2, lines[-1])):
        for name, first, last in _TLE_FIELDS[number]:
            try:
                float(line[first - 1 : last])
            except ValueError as error:
                said = line[first - 1 : last].strip()
                raise ValueError(f"TLE line {number}, {name} (columns {first} to {last}): {said!r}") from error
    if lines[-2][2:7] != lines[-1][2:7]:
        raise ValueError(f"TLE lines 1 and 2 are of two objects, {lines[-2][2:7]} and {lines[-1][2:7]}")


def _from_omm(fields: Any) -> Any:
    if not isinstance(fields, Mapping):
        raise ValueError("an OMM as JSON is an object of fields, or a list with one")
    missing = [name for name in _OMM_FIELDS if fields.get(name) in (None, "")]
    if missing:
        raise ValueError(f"the OMM has no {', '.join(missing)}")
    theory = fields.get("MEAN_ELEMENT_THEORY") or "SGP4"
    if theory not in ("SGP4", "SGP"):
        raise ValueError(f"elements of the theory {theory!r} are not SGP4's")
    given = {key: value for key, value in fields.items() if value not in (None, "")}
    # CCSDS 502.0 allows any number of decimals, and a Z; the reader wants one to six, and none.
    whole, _, decimals = str(given["EPOCH"]).removesuffix("Z").partition(".")
    satellite = Satrec()
    omm.initialize(satellite, {**_OMM_DEFAULTS, **given, "EPOCH": f"{whole}.{(decimals or '0')[:6]}"})
    return satellite
