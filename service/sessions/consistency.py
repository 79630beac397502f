"""Whether what was told of a frame agrees with itself and with what is seen: site, time, orbit, pointing, scale."""

from __future__ import annotations

from datetime import datetime

import numpy as np

from service.attitude.camera import Site
from service.attitude.earth import gcrf_to_itrf, zenith_frame
from service.inference.state import Array, Estimate
from service.sessions.absolute import View
from service.sessions.ranging import Ranged

_OLD_DAYS = 14.0  # elements of a low orbit are kilometres off by then
_ASIDE_DEG = 0.5  # beside the field of view: mounts are seldom worse
_FIELD_DEG = 0.5  # half of it, where the pixel scale is not known
_AT_THE_END = 0.9  # of the tolerance that a scale was sought in: it would have gone on


def warnings_of(
    estimate: Estimate, moment: datetime, site: Site | None, view: View | None, ranged: Ranged | None
) -> list[str]:
    """What does not agree, in degrees and per cent, for people; nothing of it changes an estimate."""
    if ranged is None or site is None:
        return []
    seen, found = ranged.sighting, []
    if seen.elevation_deg < 0:
        found.append(f"the orbit puts the object {-seen.elevation_deg:.1f}° below the site's horizon")
    if abs(seen.elements_age_days) > _OLD_DAYS:
        found.append(f"the orbit's elements are {abs(seen.elements_age_days):.0f} days from the frame")
    if view is not None:
        apart = pointing_error_deg(view, site, moment, seen.azimuth_deg, seen.elevation_deg)
        if apart > field_deg(view) + _ASIDE_DEG:
            found.append(f"the camera points {apart:.1f}° away from where the orbit puts the object")
    if ranged.scale_px is not None and ranged.bounds_px is not None and estimate.status == "tracking":
        share, allowed = estimate.best.scale / ranged.scale_px - 1, ranged.bounds_px[1] / ranged.scale_px - 1
        if abs(share) > _AT_THE_END * allowed:
            size = "larger" if share > 0 else "smaller"
            found.append(
                f"the body is {abs(share):.0%} {size} than range, pixel scale and the model's unit say, or more"
            )
    return found


def pointing_error_deg(view: View, site: Site, moment: datetime, azimuth_deg: float, elevation_deg: float) -> float:
    """Between the optical axis and a direction in the site's sky."""
    azimuth, elevation = np.deg2rad([azimuth_deg, elevation_deg])
    level = np.cos(elevation)
    local = np.array([level * np.sin(azimuth), level * np.cos(azimuth), np.sin(elevation)])  # east, north, up
    towards: Array = gcrf_to_itrf(moment).T @ zenith_frame(site.latitude_deg, site.longitude_deg) @ local
    axis = view.camera.to_gcrf @ np.array([0.0, 0.0, -1.0 if view.camera.mirrored else 1.0])
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(axis, towards)), axis @ towards)))


def field_deg(view: View) -> float:
    """From the middle of the image to its corner."""
    scale = view.camera.pixel_scale_deg
    return _FIELD_DEG if scale is None else scale * float(np.hypot(*view.centre_px))
