"""The Earth as a satellite has it: in the way of the Sun, and a lamp beside it.

The shadow's cones are those of Montenbruck & Gill, *Satellite Orbits* (2000), section 3.4.2: two discs, the Sun's and
the Earth's, in the satellite's sky. The Earth's flattening is taken in by stretching space along the pole until it is
a sphere. The air is left out: it bends and dims light within some 20 km of the edge, a few seconds of a low orbit.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from service.inference.state import Array

SUN_RADIUS_KM = 695_700.0
EARTH_RADIUS_KM = 6378.137
_POLE_STRETCH = 1.0 / (1.0 - 1.0 / 298.257_223_563)  # WGS 84
EARTH_ALBEDO = 0.3

Shade = Literal["sunlit", "penumbra", "umbra"]


def sunlit_share(place_km: Array, sun_km: Array) -> float:
    """Share of the Sun's disc that a satellite sees past the Earth, 0 to 1.

    ``place_km`` and ``sun_km`` (3,) are from the Earth's centre, GCRF.
    """
    stretched = np.array([1.0, 1.0, _POLE_STRETCH])
    place, to_sun = place_km * stretched, (sun_km - place_km) * stretched
    height, distance = float(np.linalg.norm(place)), float(np.linalg.norm(to_sun))
    sun = float(np.arcsin(SUN_RADIUS_KM / distance))
    earth = float(np.arcsin(min(1.0, EARTH_RADIUS_KM / height)))
    apart = float(np.arccos(np.clip(-(place @ to_sun) / (height * distance), -1.0, 1.0)))
    return 1.0 - _covered(sun, earth, apart)


def shade(share: float) -> Shade:
    """The word for a share of ``sunlit_share``."""
    if share >= 1.0:
        return "sunlit"
    return "penumbra" if share > 0.0 else "umbra"


def earthshine(place_km: Array, sun_km: Array) -> float:
    """Light of the sunlit Earth on a satellite, as a share of the Sun's own outside of the shadow.

    That of a Lambert sphere seen from afar: 2/3 A (R / (R + h))^2 (sin a + (pi - a) cos a) / pi, with the albedo A 0.3
    and a the angle at the Earth between Sun and satellite. A rough prior: clouds alone halve or double it.
    """
    height = float(np.linalg.norm(place_km))
    cosine = float(np.clip(place_km @ sun_km / (height * np.linalg.norm(sun_km)), -1.0, 1.0))
    angle = float(np.arccos(cosine))
    phase = (np.sin(angle) + (np.pi - angle) * cosine) / np.pi
    return float(2.0 / 3.0 * EARTH_ALBEDO * min(1.0, EARTH_RADIUS_KM / height) ** 2 * phase)


def earth_aside(place_km: Array) -> float:
    """Light of the Earth on a face that is turned across it, as a share of that on one that faces it.

    That of an even disc of angular radius p: (p - sin p cos p) / (pi sin^2 p); 0.31 at a height of 500 km.
    """
    radius = float(np.arcsin(min(1.0, EARTH_RADIUS_KM / float(np.linalg.norm(place_km)))))
    return float((radius - np.sin(radius) * np.cos(radius)) / (np.pi * np.sin(radius) ** 2))


def _covered(sun: float, earth: float, apart: float) -> float:
    """Share of a disc of radius ``sun`` under one of radius ``earth``, their centres ``apart``: radians, flat sky."""
    if apart >= sun + earth:
        return 0.0
    if apart <= abs(earth - sun):
        return min(1.0, (earth / sun) ** 2)
    chord = (apart**2 + sun**2 - earth**2) / (2 * apart)  # from the Sun's centre to the line through both edges
    half = np.sqrt(max(0.0, sun**2 - chord**2))
    lens = sun**2 * np.arccos(chord / sun) + earth**2 * np.arccos((apart - chord) / earth) - apart * half
    return float(np.clip(lens / (np.pi * sun**2), 0.0, 1.0))
