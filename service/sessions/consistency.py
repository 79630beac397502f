"""Whether what was told of a frame agrees with itself and with what is seen: site, time, orbit, pointing, scale."""

from __future__ import annotations

from datetime import datetime

import numpy as np

from service.attitude.camera import Site, horizontal_direction
from service.inference.pose import directions_apart
from service.inference.state import Estimate
from service.sessions.absolute import Aim
from service.sessions.ranging import Ranged

_OLD_DAYS = 14.0  # elements of a low orbit are kilometres off by then
_ASIDE_DEG = 0.5  # beside the field of view: mounts are seldom worse
_FIELD_DEG = 0.5  # half of it, where the pixel scale is not known
_AT_THE_END = 0.8  # of the tolerance that a scale was sought in: it would have gone on
_DRAWN = 0.5  # the same of what does not fit: mirrored bodies of the right size stay within 0.4
_OUT_OF_SIGHT = ("no_target", "lost")  # any other status has a size; one far off is often why nothing fits
_FITS = ("tracking", "ambiguous")
_BEYOND = 1.05  # the light's extent against the diameter of the largest scale allowed
_WITHIN = 0.2  # the same against the smallest: bodies are seen shorter than their diameter, and half in shadow


def warnings_of(
    estimate: Estimate, moment: datetime, site: Site | None, aim: Aim | None, ranged: Ranged | None
) -> list[str]:
    """What does not agree, in degrees and per cent, for people; nothing of it changes an estimate."""
    if ranged is None or site is None:
        return []
    seen, found = ranged.sighting, []
    if seen.elevation_deg < 0:
        found.append(f"the orbit puts the object {-seen.elevation_deg:.1f}° below the site's horizon")
    if abs(seen.elements_age_days) > _OLD_DAYS:
        found.append(f"the orbit's elements are {abs(seen.elements_age_days):.0f} days from the frame")
    if aim is not None:
        towards = horizontal_direction(seen.azimuth_deg, seen.elevation_deg, site, moment)
        apart = np.rad2deg(directions_apart(aim.axis, towards))
        if apart > (_FIELD_DEG if aim.field_deg is None else aim.field_deg) + _ASIDE_DEG:
            found.append(f"the camera points {apart:.1f}° away from where the orbit puts the object")
    if ranged.scale_px is not None and ranged.bounds_px is not None:
        found += _size_warnings(estimate, ranged.scale_px, ranged.bounds_px)
    return found


def _size_warnings(estimate: Estimate, expected: float, bounds: tuple[float, float]) -> list[str]:
    """Of a size that is a little off, the pose tells; of one too far off for any pose to fit, the light itself."""
    seen = estimate.light_scale
    if seen is not None and estimate.status not in _FITS and not _WITHIN * bounds[0] < seen < _BEYOND * bounds[1]:
        times = f"{float(f'{seen / expected:.2g}'):,g} times"
        return [f"the light is {times} as long as the body is by range, pixel scale and the model's unit"]
    if estimate.status in _OUT_OF_SIGHT:
        return []
    share, allowed = estimate.best.scale / expected - 1, bounds[1] / expected - 1
    if abs(share) <= (_DRAWN if estimate.status == "no_fit" else _AT_THE_END) * allowed:
        return []
    if estimate.status == "no_fit":  # which way a size is wrong is not told by what fits at none
        return [f"nothing fits within {allowed:.0%} of the size by range, pixel scale and the model's unit"]
    size = "larger" if share > 0 else "smaller"
    return [f"the body is {abs(share):.0%} {size} than range, pixel scale and the model's unit say, or more"]
