"""A pass over a real place: a camera that follows a satellite, under the real Sun.

The camera's up keeps its angle to celestial north (an equatorial mount). The satellite keeps its own attitude, or its
own rate, among the stars; so the camera sees it turned as it follows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta

import numpy as np

from service.attitude.camera import Site, horizontal_direction
from service.attitude.orbit import Orbit, Sighting
from service.attitude.pointing import CameraOrientation, Mount, Pointing, camera_orientation
from service.attitude.shadow import earthshine, sunlit_share
from service.attitude.sun import in_camera, phase_angle_deg, sun_from_earth
from service.inference.pose import from_matrices, multiply
from service.inference.state import Array, Poses
from service.simulate.motion import Track
from service.simulate.render import Light


class OverflightError(ValueError):
    """The satellite is not to be seen."""


@dataclass(frozen=True)
class Overflight:
    """Where a satellite is seen from, and when. ``elements`` is a TLE (or an OMM) as text."""

    site: Site
    elements: str
    start: datetime
    up_angle_deg: float = 0.0
    told_from: Site | None = None
    """Where the scenario's first orientation and size are seen; None: at ``site``. Two sites of one object share it."""


@dataclass(frozen=True)
class Look:
    """One frame: the satellite in the sky, the camera, and the light on what it sees."""

    moment: datetime
    sighting: Sighting
    ra_deg: float
    dec_deg: float
    camera: CameraOrientation
    light: Light

    @property
    def sunlit(self) -> float:
        """Share of the Sun's disc that the Earth leaves free."""
        return self.light.sun


def follow(overflight: Overflight, times_s: Sequence[float], light: Light) -> list[Look]:
    """A look for each of the times since the start. Gloss and even light are those of ``light``.

    Raises ``OverflightError`` where the satellite is below the horizon, ``ConfigError`` for unreadable elements.
    """
    orbit = Orbit(overflight.elements)
    moments = [overflight.start + timedelta(seconds=float(time_s)) for time_s in times_s]
    return [_look(overflight, orbit, moment, light) for moment in moments]


def told(overflight: Overflight, light: Light) -> Look:
    """What a scenario's first orientation and size refer to. Raises as ``follow``."""
    return follow(replace(overflight, site=overflight.told_from or overflight.site), [0.0], light)[0]


def seen(track: Track, looks: Sequence[Look], first: Look) -> Track:
    """The truth as the camera that follows sees it: turned against it, and scaled with the range.

    ``first``: the look that the track is told for.
    """
    turns = from_matrices(np.stack([look.camera.to_gcrf.T @ first.camera.to_gcrf for look in looks]))
    nearer = np.log([first.sighting.range_km / look.sighting.range_km for look in looks])
    poses = track.poses
    log_scale = poses.log_scale[0] + nearer
    return replace(
        track, poses=Poses(multiply(turns, poses.quaternion), poses.position, np.asarray(log_scale), poses.joints)
    )


def utc_text(moment: datetime) -> str:
    """ISO 8601, UTC, to the microsecond."""
    return moment.astimezone(UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")


def _look(overflight: Overflight, orbit: Orbit, moment: datetime, light: Light) -> Look:
    sighting = orbit.seen_from(overflight.site, moment)
    if sighting.elevation_deg <= 0:
        raise OverflightError(
            f"at {utc_text(moment)} the satellite is {-sighting.elevation_deg:.1f} degrees below the horizon"
        )
    forward = horizontal_direction(sighting.azimuth_deg, sighting.elevation_deg, overflight.site, moment)
    ra_deg = float(np.rad2deg(np.arctan2(forward[1], forward[0])) % 360.0)
    dec_deg = float(np.rad2deg(np.arcsin(np.clip(forward[2], -1.0, 1.0))))
    mount = Mount(up_angle_deg=overflight.up_angle_deg, site=overflight.site)
    camera = camera_orientation(Pointing(ra_deg=ra_deg, dec_deg=dec_deg), mount, moment)
    assert camera is not None  # direction and up angle are given
    return Look(moment, sighting, ra_deg, dec_deg, camera, _light(light, sighting, camera, moment))


def _light(light: Light, sighting: Sighting, camera: CameraOrientation, moment: datetime) -> Light:
    place, sun = np.array(sighting.place_km), sun_from_earth(moment)
    towards_sun: Array = in_camera(sun, camera)
    x, y, z = (float(value) for value in in_camera(-place, camera))
    return replace(
        light,
        phase_deg=phase_angle_deg(towards_sun),
        sun_roll_deg=float(np.rad2deg(np.arctan2(towards_sun[1], towards_sun[0]))),
        ambient=0.0,
        sun=sunlit_share(place, sun),
        earth=earthshine(place, sun),
        towards_earth=(x, y, z),
    )
