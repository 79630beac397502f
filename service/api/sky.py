"""The wire: absolute attitude, the camera among the stars, and the light."""

from __future__ import annotations

from typing import Literal

from service.api.wire import Orientation, Wire


class Attitude(Wire):
    """Rotation body -> GCRF. What is not known is left out."""

    frame: Literal["GCRF"]
    orientation: Orientation
    angular_velocity_body_deg_s: list[float] | None = None
    """Of the body against GCRF, along the body's axes; of `mean` and `best`, from the second frame on."""
    angular_velocity_gcrf_deg_s: list[float] | None = None
    """The same along the axes of GCRF."""
    covariance_body_deg2: list[list[float]] | None = None
    """Of a small rotation about the body's axes; of `mean`."""
    covariance_gcrf_deg2: list[list[float]] | None = None
    """The same about the axes of GCRF."""


class EarthOrientation(Wire):
    """The data behind azimuth and elevation."""

    known: bool
    """False where the moment lies outside of the installed data: UT1 = UTC was taken, good to 14 arcseconds."""
    age_days: float
    """From the newest measured value to the moment; negative where it was measured."""
    ut1_utc_s: float


class Camera(Wire):
    """The camera among the stars."""

    frame: Literal["GCRF"]
    orientation: Orientation
    """Rotation camera (x right, y down) -> GCRF. Of a mirrored image the z axis comes towards the observer."""
    mirrored: bool
    earth_orientation: EarthOrientation | None
    """Null where the Earth's rotation was not needed."""


class Orbit(Wire):
    """Where the object stands in the sky of the site, by `prior.orbit`."""

    range_km: float
    azimuth_deg: float
    """From north through east."""
    elevation_deg: float
    """Without refraction."""
    elements_age_days: float
    """From the epoch of the elements to the frame."""
    expected_scale_px: float | None
    """Pixels per model unit at this range, about which the scale is sought; null where `prior.unit_m` or the pixel
    scale is not known, or the object is below the horizon."""
    earth_orientation: EarthOrientation


class Direction(Wire):
    """Unit vector in camera axes: x right, y down, z away from the camera (of a mirrored image too)."""

    x: float
    y: float
    z: float


class Light(Wire):
    """Where the object's light comes from. Estimates of releases before it was told lack it: unknown."""

    sun: Direction | None = None
    """Towards the Sun. Null where nobody told it and time or camera orientation are not known."""
    source: Literal["ephemeris", "told", "fitted", "unknown"] = "unknown"
    """`ephemeris`: by the frame's time and the camera's orientation. `told`: with the frame or the session."""
    sigma_deg: float | None = None
    """Standard deviation of that direction; null where it is not known."""
    phase_deg: float | None = None
    """Angle Sun-object-observer: 0 is full light."""
    sunlit: bool | None = None
    """False in the Earth's umbra; null without `prior.orbit` or the frame's time."""
