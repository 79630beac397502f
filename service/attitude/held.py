"""The frames that a satellite on a known orbit may be held in."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta

import numpy as np

from service.attitude.camera import Site
from service.attitude.orbit import Orbit
from service.attitude.sun import sun_from_earth
from service.inference.spin.held_frames import nadir_frames, sun_frames, yaw_steering_frames
from service.inference.state import Array

_HALF = timedelta(seconds=0.5)  # numerical: of a difference quotient along the orbit


def held_frames(orbit: Orbit, site: Site, moments: Sequence[datetime]) -> dict[str, Array]:
    """(n, 3, 3) reference -> GCRF of the attitude modes that hold one. Raises ``InputError``: SGP4 has no answer."""
    before, after = (
        np.array([orbit.seen_from(site, moment + step).place_km for moment in moments]) for step in (-_HALF, _HALF)
    )
    place = 0.5 * (before + after)
    sun = np.array([sun_from_earth(moment) for moment in moments]) - place
    return {
        "nadir_pointing": nadir_frames(place, after - before),
        "yaw_steering": yaw_steering_frames(place, sun),
        "sun_pointing": sun_frames(sun),
    }
