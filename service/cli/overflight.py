"""``--site``, ``--tle`` and ``--time``: a real satellite over a real place."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import typer

from service.attitude.camera import Site
from service.simulate.overflight import Overflight


def read_overflights(
    sites: Sequence[str], tle: Path | None, time: str | None, up_angle_deg: float
) -> tuple[Overflight, ...]:
    """One for each site, of the same object; the three together, or none of them. Raises ``typer.BadParameter``."""
    if not sites and tle is None and time is None:
        return ()
    if not sites or tle is None or time is None:
        raise typer.BadParameter("--site, --tle and --time go together")
    places, elements, start = [parse_site(site) for site in sites], read_elements(tle), parse_time(time)
    return tuple(Overflight(place, elements, start, up_angle_deg, places[0]) for place in places)


def read_elements(path: Path) -> str:
    """Orbital elements as text. Raises ``typer.BadParameter``."""
    try:
        return path.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise typer.BadParameter(f"{path}: {error}", param_hint="--tle") from error


def parse_site(text: str) -> Site:
    """``LAT,LON`` or ``LAT,LON,HEIGHT`` -> a place: degrees north and east, metres."""
    try:
        latitude, longitude, height = (*(float(part) for part in text.split(",")), 0.0)[:3]
    except ValueError as error:
        raise typer.BadParameter(f"{text!r} is no site LAT,LON,HEIGHT", param_hint="--site") from error
    if not (abs(latitude) <= 90 and abs(longitude) <= 360 and text.count(",") <= 2):
        raise typer.BadParameter(f"{text!r} is no place on the Earth", param_hint="--site")
    return Site(latitude, longitude, height)


def parse_time(text: str) -> datetime:
    """ISO 8601; UTC where no offset is said."""
    try:
        moment = datetime.fromisoformat(text)
    except ValueError as error:
        raise typer.BadParameter(f"{text!r} is no time such as 2026-11-22T04:30:00Z", param_hint="--time") from error
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment
