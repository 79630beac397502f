"""A session's range to its object, and the scale that follows from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from service.attitude.held import held_frames
from service.attitude.orbit import Orbit, Sighting, check_sums
from service.errors import InputError
from service.imaging.facts import FrameFacts
from service.inference.held import Held
from service.inference.params import PriorParams, SessionConfig
from service.inference.pose import conjugate, from_matrices, multiply
from service.sessions.absolute import View, mount_of
from service.sessions.frame import FrameTime

_ARCSECOND = np.pi / 648_000
_ARCSECONDS = 3600.0
_KM = 1000.0
_SIGMAS = 3.0  # of a told scale, looked at on either side


@dataclass(frozen=True)
class Ranged:
    """What the orbit says of one frame."""

    sighting: Sighting
    scale_px: float | None  # px per model unit; None: unit or pixel scale unknown, or below the horizon
    bounds_px: tuple[float, float] | None

    def document(self) -> dict[str, Any]:
        """``orbit`` of an estimate as the API answers it."""
        seen, earth = self.sighting, self.sighting.earth
        return {
            "range_km": seen.range_km,
            "azimuth_deg": seen.azimuth_deg,
            "elevation_deg": seen.elevation_deg,
            "elements_age_days": seen.elements_age_days,
            "expected_scale_px": self.scale_px,
            "earth_orientation": {
                "known": earth.known,
                "age_days": earth.age_days,
                "ut1_utc_s": earth.ut1_utc_s,
            },
        }


def orbit_warnings(config: SessionConfig) -> list[str]:
    """Of a new session's orbit. Raises ``ConfigError`` for one that cannot be read."""
    Ranging(config)
    return [] if config.prior.orbit is None else check_sums(config.prior.orbit)


class Ranging:
    """The orbit of a session's object, if it was given. Raises ``ConfigError`` for one that cannot be read."""

    def __init__(self, config: SessionConfig) -> None:
        self._config = config
        self.site = mount_of(config.camera).site
        self._orbit = None if config.prior.orbit is None else Orbit(config.prior.orbit)

    def at(self, moment: FrameTime, facts: FrameFacts) -> Ranged | None:
        """Range and scale at a frame; None without an orbit. Raises ``InputError`` where its time is not known.

        A pixel scale that the frame's own header tells goes before the session's.
        """
        if self._orbit is None or self.site is None:
            return None
        if moment.given is None:
            raise InputError("an orbit needs the frame's time", field="query:time")
        sighting = self._orbit.seen_from(self.site, moment.utc)
        unit_m, arcsec = self._config.prior.unit_m, self._config.camera.pixel_scale_arcsec
        if facts.pixel_scale_deg is not None:
            arcsec = facts.pixel_scale_deg * _ARCSECONDS
        if unit_m is None or arcsec is None or sighting.elevation_deg <= 0:
            return Ranged(sighting, None, None)
        scale = unit_m / (sighting.range_km * _KM * arcsec * _ARCSECOND)
        share = self._config.prior.scale_tolerance
        return Ranged(sighting, scale, (scale * (1 - share), scale * (1 + share)))

    def held(self, moment: FrameTime, view: View | None) -> Held | None:
        """The attitude mode that was told, at a frame; None: none, or the camera's orientation is not known."""
        mode, uses = self._config.prior.attitude_mode, self._config.filter.method != "bootstrap"
        if mode is None or view is None or self._orbit is None or self.site is None or not uses:
            return None
        to_gcrf = held_frames(self._orbit, self.site, [moment.utc])[mode][0]
        w, x, y, z = multiply(conjugate(view.quaternion), from_matrices(to_gcrf)).tolist()
        return Held(mode, (w, x, y, z))


def scale_bounds(prior: PriorParams, ranged: Ranged | None) -> tuple[float, float] | None:
    """Least and greatest scale to look at, px of the whole frame per model unit: told, or by the range; else None."""
    if prior.scale_px is not None:
        factor = float(np.exp(_SIGMAS * prior.scale_sigma))
        return prior.scale_px / factor, prior.scale_px * factor
    return None if ranged is None else ranged.bounds_px
