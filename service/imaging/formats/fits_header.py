"""Time and pointing out of a FITS header.

Time is that of the middle of the exposure: DATE-AVG, or DATE-OBS and half of EXPTIME, in UTC. Pointing is that of
the world coordinate system where the image was solved; otherwise RA, DEC and POSANGLE as the mount told them.
"""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime, time, timedelta
from typing import Literal

import numpy as np
from astropy.io import fits
from astropy.wcs import WCS
from numpy.typing import NDArray

from service.imaging.facts import FrameFacts
from service.imaging.headers import broken

_EXPOSURE_CARDS = ("EXPTIME", "EXPOSURE", "XPOSURE")
_STEP_PX = 0.5  # numerical: of a difference


def read_header_facts(header: fits.Header, *, width: int, height: int, top_down: bool) -> FrameFacts:
    """What the header states. Raises ``ImageError`` for a time or position that it states and nobody can read."""
    moment = _time(header)
    equinox = _equinox(header)
    solved = _world(header)
    if solved is None:
        return FrameFacts(
            time=moment,
            ra_deg=_angle(header, ("RA", "OBJCTRA"), hours=15.0),
            dec_deg=_angle(header, ("DEC", "OBJCTDEC"), hours=1.0),
            position_angle_deg=_number(header, "POSANGLE"),
            equinox=equinox,
        )
    upward = -1.0 if top_down else 1.0  # along the file's rows
    # FITS counts pixel centres from 1; astropy, asked with origin 0, from 0.
    x, y = width / 2 - 0.5, height / 2 - 0.5
    points = solved.wcs_pix2world([[x, y], [x, y + _STEP_PX * upward], [x + _STEP_PX, y]], 0)
    centre, above, right = (_unit(ra, dec) for ra, dec in points[:, [solved.wcs.lng, solved.wcs.lat]])
    up, side = _east_north(centre, above), _east_north(centre, right)
    handed = up[0] * side[1] - up[1] * side[0]  # east-left images: the right is clockwise of up as seen on the sky
    return FrameFacts(
        time=moment,
        ra_deg=math.degrees(math.atan2(centre[1], centre[0])) % 360.0,
        dec_deg=math.degrees(math.asin(centre[2])),
        position_angle_deg=math.degrees(math.atan2(up[0], up[1])) % 360.0,
        mirrored=bool(handed < 0),
        equinox=equinox,
        pixel_scale_deg=math.degrees(math.sqrt(abs(handed))) / _STEP_PX,
    )


def _world(header: fits.Header) -> WCS | None:
    """The celestial part of the header's world coordinates, in right ascension and declination, or None."""
    if "CTYPE1" not in header or "CRVAL1" not in header:
        return None
    found = WCS(header).celestial
    return found if found.naxis == 2 and found.wcs.lngtyp == "RA" else None


def _unit(ra_deg: float, dec_deg: float) -> NDArray[np.float64]:
    ra, dec = math.radians(ra_deg), math.radians(dec_deg)
    return np.array([math.cos(dec) * math.cos(ra), math.cos(dec) * math.sin(ra), math.sin(dec)])


def _east_north(centre: NDArray[np.float64], point: NDArray[np.float64]) -> tuple[float, float]:
    """A near point's offset on the tangent plane, radians."""
    east = np.array([-centre[1], centre[0], 0.0])
    east /= np.linalg.norm(east)
    return float(point @ east), float(point @ np.cross(centre, east))


def _time(header: fits.Header) -> datetime | None:
    if str(header.get("TIMESYS", "UTC")).strip().upper() not in ("UTC", ""):
        return None  # other scales are rare in cameras' files; a wrong minute would be worse than none
    middle = _moment(header, "DATE-AVG")
    if middle is not None:
        return middle
    start = _moment(header, "DATE-OBS") or _moment(header, "DATE-BEG")
    exposure_s = next((_number(header, name) for name in _EXPOSURE_CARDS if name in header), None)
    return None if start is None else start + timedelta(seconds=(exposure_s or 0.0) / 2)


def _moment(header: fits.Header, card: str) -> datetime | None:
    text = str(header.get(card, "")).strip()
    if not text:
        return None
    try:
        moment = datetime.fromisoformat(text)
        if len(text) == len("2026-11-21") and "TIME-OBS" in header:
            moment = datetime.combine(moment, time.fromisoformat(str(header["TIME-OBS"]).strip()))
    except ValueError as error:
        raise broken(f"FITS: {card} is no date: {text!r}") from error
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)


def _angle(header: fits.Header, cards: tuple[str, str], hours: float) -> float | None:
    """Degrees, of a number of degrees or of sexagesimal text (``hours``: degrees per its first unit)."""
    for card in cards:
        value = header.get(card)
        if isinstance(value, int | float) and not isinstance(value, bool):
            return float(value)
        if isinstance(value, str) and value.strip():
            return _sexagesimal(card, value) * hours
    return None


def _sexagesimal(card: str, text: str) -> float:
    parts: list[str] = re.split(r"[\s:hdms°'\"]+", text.strip().rstrip("sS'\""))
    try:
        first, *rest = (abs(float(part)) for part in parts)
    except ValueError as error:
        raise broken(f"FITS: {card} is no angle: {text!r}") from error
    size = float(first + sum(part / 60.0 ** (k + 1) for k, part in enumerate(rest)))
    return -size if text.strip().startswith("-") else size


def _number(header: fits.Header, card: str) -> float | None:
    value = header.get(card)
    if value is None or isinstance(value, str | bool):
        return None
    return float(value)


def _equinox(header: fits.Header) -> Literal["J2000", "date"] | None:
    """J2000 or the equinox of date; mounts that count in the latter write the year of the observation."""
    year = _number(header, "EQUINOX")
    return None if year is None else "date" if abs(year - 2000.0) > 0.5 else "J2000"
