"""The light on a session's object at each frame: told, or by Sun, camera and orbit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from service.attitude.shadow import earth_aside, earthshine, sunlit_share
from service.attitude.sun import in_camera, phase_angle_deg, sun_from_earth
from service.errors import InputError
from service.inference.light import Light, Vector, unit
from service.inference.params import CameraParams, SessionConfig
from service.inference.state import Array
from service.sessions.absolute import View
from service.sessions.frame import FrameTime
from service.sessions.ranging import Ranged

Source = Literal["ephemeris", "told", "fitted", "unknown"]


@dataclass(frozen=True)
class Lit:
    """The light at one frame, and who says so."""

    light: Light = field(default_factory=Light)
    source: Source = "unknown"

    def document(self) -> dict[str, Any]:
        """``light`` of an estimate as the API answers it."""
        light = self.light
        sun = None if light.towards_sun is None else np.array(light.towards_sun)
        return {
            "sun": None if sun is None else dict(zip("xyz", sun.tolist(), strict=True)),
            "source": self.source,
            "sigma_deg": None if light.sigma_rad is None else float(np.rad2deg(light.sigma_rad)),
            "phase_deg": None if sun is None else phase_angle_deg(sun),
            "sunlit": None if light.sunlit is None else light.sunlit > 0.0,
        }


UNKNOWN = Lit()


def told_sun(text: str) -> Vector:
    """The unit vector of a frame's query ``sun=x,y,z``. Raises ``InputError``."""
    try:
        return unit([float(part) for part in text.split(",")])
    except ValueError as error:
        raise InputError(f"sun is x,y,z towards the Sun in camera axes: {error}", field="query:sun") from error


def light_at(
    config: SessionConfig,
    query: Mapping[str, Any],
    moment: FrameTime | None = None,
    view: View | None = None,
    ranged: Ranged | None = None,
) -> Lit:
    """The light at a frame, of what its ``query``, its time, the camera and the object's orbit say.

    A direction in the query goes before the session's. Nothing is computed for a time that was not given, and nothing
    is guessed where the camera's orientation is not known. Raises ``InputError`` for a time without an ephemeris.
    """
    told = _told(config.light.sun, query)
    if told is None and config.light.sun == "unknown":
        return UNKNOWN
    camera = None if view is None else view.camera
    light = Light(mirrored=config.camera.mirrored if camera is None else camera.mirrored)
    sun_km = _sun_km(moment) if camera is not None or ranged is not None else None
    if sun_km is not None and ranged is not None:
        place_km = np.array(ranged.sighting.place_km)
        light = replace(
            light,
            sunlit=sunlit_share(place_km, sun_km),
            earth=None if camera is None else _vector(in_camera(-place_km, camera)),
            earthshine=earthshine(place_km, sun_km),
            earth_aside=earth_aside(place_km),
        )
    sigma = float(np.deg2rad(config.light.sun_sigma_deg))
    if told is not None:
        return Lit(replace(light, towards_sun=told, sigma_rad=sigma), "told")
    if sun_km is None or camera is None:
        return Lit(light)
    return Lit(replace(light, towards_sun=_vector(in_camera(sun_km, camera)), sigma_rad=sigma), "ephemeris")


def sun_in_image(estimate: Mapping[str, Any], camera: CameraParams) -> Array | None:
    """(3,) towards the Sun, out of an estimate, in the axes of its image: of a mirrored one z is turned round too."""
    sun, view = (estimate.get("light") or {}).get("sun"), estimate.get("camera")
    if sun is None:
        return None
    mirrored = camera.mirrored if view is None else view["mirrored"]
    return np.array([sun["x"], sun["y"], -sun["z"] if mirrored else sun["z"]])


def _told(session: str | Vector, query: Mapping[str, Any]) -> Vector | None:
    if "sun" in query:
        return told_sun(query["sun"])
    return None if isinstance(session, str) else unit(session)


def _sun_km(moment: FrameTime | None) -> Array | None:
    return None if moment is None or moment.given is None else sun_from_earth(moment.utc)


def _vector(array: Array) -> Vector:
    x, y, z = array.tolist()
    return (x, y, z)
