"""What a session says of the scene: where the object can be, the camera, the light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from service.inference.checks import FORBID, FieldError, require
from service.inference.light import unit


@dataclass(frozen=True)
class PriorParams:
    """Where a pose can be before the first frame (uniform, the paper's bounds)."""

    __pydantic_config__: ClassVar[dict[str, Any]] = FORBID

    min_extent: float = 0.1
    """The object spans at least this share of the image."""
    max_extent: float = 1.0
    """The object spans at most this share of the image."""
    orbit: str | None = None
    """The object's mean elements, as text: a TLE of two or three lines, or an OMM as JSON, XML or KVN. With the
    camera's site each estimate tells the range; with `unit_m` and the camera's `pixel_scale_arcsec` too, the scale is
    known from it."""
    unit_m: float | None = None
    """Metres in a unit of the model."""
    scale_tolerance: float = 0.1
    """The scale lies within this share of the one that range, unit and pixel scale make."""
    scale_px: float | None = None
    """The scale where it is known otherwise, pixels of the whole frame per model unit. It goes before a range's."""
    scale_sigma: float = 0.03
    """Standard deviation of `scale_px`, as a share of it. No scale farther than three of them is looked at."""
    mesh_error: float = 0.0
    """Relative error of the mesh, a standard deviation, where the body is not quite its model: 0.05 where parts are 5 %
    off in size. It moves all poses of a pass alike, which no frame shows: spreads and particles are stated with a third
    of it in radians about each axis (1° for 0.05), and lookalikes stay in doubt for longer. Not for `bootstrap`."""
    attitude_mode: Literal["nadir_pointing", "yaw_steering", "sun_pointing"] | None = None
    """The body is believed to be held so: among poses that a frame cannot tell apart, those that are aligned go before.
    It needs `orbit`, and in each frame the camera's orientation; estimates whose modes it weighed have `attitude_mode`
    in `assumed`. The motion of the pass is told without it."""

    def __post_init__(self) -> None:
        require(0 < self.min_extent < self.max_extent <= 10, "0 < min_extent < max_extent <= 10 is required")
        require(self.orbit is None or 0 < len(self.orbit) <= 20_000, "orbit is a TLE or an OMM")
        require(self.unit_m is None or 1e-6 <= self.unit_m <= 1e6, "unit_m must be between 1e-6 and 1e6")
        require(0.001 <= self.scale_tolerance <= 0.9, "scale_tolerance must be between 0.001 and 0.9")
        require(self.scale_px is None or 1e-6 <= self.scale_px <= 1e6, "scale_px must be between 1e-6 and 1e6")
        require(0.001 <= self.scale_sigma <= 0.5, "scale_sigma must be between 0.001 and 0.5")
        require(0 <= self.mesh_error <= 0.5, "mesh_error must be between 0 and 0.5")


@dataclass(frozen=True)
class CameraParams:
    """What is known of the camera."""

    __pydantic_config__: ClassVar[dict[str, Any]] = FORBID

    psf_sigma_px: float | None = None
    """Width of the point spread (Gaussian sigma); estimated from the frames where it is not given."""
    mount: Literal["equatorial", "altaz"] = "equatorial"
    """What `up_angle_deg` counts from: north, or the zenith (the field then rotates among the stars)."""
    up_angle_deg: float | None = None
    """From north (`equatorial`) or the zenith (`altaz`) to the image's up direction, in the sense north through east
    (anticlockwise on the sky). A frame's `position_angle_deg` goes before it. Without either no attitude is given."""
    mirrored: bool = False
    """The image is a mirror image of the sky (an odd number of reflections)."""
    equinox: Literal["J2000", "date"] = "J2000"
    """What right ascension, declination and position angle refer to: `date` is the true equator of date."""
    pixel_scale_arcsec: float | None = None
    """Of one pixel on the sky: takes the object's place in the image into account."""
    site_latitude_deg: float | None = None
    """Geodetic; needed for azimuth and elevation, and for an `altaz` mount."""
    site_longitude_deg: float | None = None
    """East of Greenwich."""
    site_height_m: float = 0.0
    """Above the ellipsoid (WGS 84); counts for a range only."""
    ser_byte_order: Literal["auto", "little", "big"] = "auto"
    """Of 16-bit SER files: their own flag is wrong in most, so `auto` looks at the pixels."""
    headers: Literal["use", "ignore"] = "use"
    """Time and pointing that frames bring in their own headers, where the call is silent."""
    roi: tuple[int, int, int, int] | None = None
    """Region of interest `[x, y, width, height]`, pixels: nothing else of a frame is looked at. What is reported stays
    in pixels of the whole frame; shares of the image (`prior`, `motion.position`) are those of the region."""
    binning: int = 1
    """Squares of so many pixels a side are averaged before anything else, for speed or faint objects."""
    perspective: float | None = None
    """Focal length of a pinhole camera, pixels of the frame: for bodies a few diameters away. `x_px`, `y_px` are then
    where the body's centre is seen, `scale_px` is the focal length over the centre's distance, and `orientation` is
    relative to the optical axis. Without it the body is taken to be far away."""
    principal_point: tuple[float, float] | None = None
    """Of that camera, `[x, y]`, pixels of the frame; without it the frame's middle."""
    transfer: Literal["linear", "srgb"] | float = "linear"
    """How light became counts, where a camera or a program has stretched them: a power p means light to the power p
    (0.45). Everything is computed from light."""
    background: Literal["posted", "auto"] = "posted"
    """Where the empty sky is known from: frames that are posted as background; with `auto`, a smooth surface through
    what lies around the object in the first frames, unless something is posted. A request's own `background` says the
    same."""

    def __post_init__(self) -> None:
        require(self.psf_sigma_px is None or 0 < self.psf_sigma_px <= 100, "psf_sigma_px must lie in (0, 100]")
        scale, latitude, longitude = self.pixel_scale_arcsec, self.site_latitude_deg, self.site_longitude_deg
        require(scale is None or 0 < scale <= 3600, "pixel_scale_arcsec must lie in (0, 3600]")
        require(self.up_angle_deg is None or abs(self.up_angle_deg) <= 360, "up_angle_deg must be within 360")
        require(latitude is None or abs(latitude) <= 90, "site_latitude_deg must be within 90")
        require(longitude is None or abs(longitude) <= 360, "site_longitude_deg must be within 360")
        require(-1000 <= self.site_height_m <= 20_000, "site_height_m must be between -1000 and 20000")
        require((latitude is None) == (longitude is None), "a site has a latitude and a longitude")
        require(self.mount == "equatorial" or latitude is not None, "an altaz mount needs the site")
        x, y, width, height = self.roi or (0, 0, 1, 1)
        require(min(x, y) >= 0 and min(width, height) >= 1, "roi is [x, y, width, height], none of them negative")
        require(1 <= self.binning <= 64, "binning must be between 1 and 64")
        focal, principal = self.perspective, self.principal_point
        require(focal is None or 1 <= focal <= 1e7, "perspective is a focal length between 1 and 1e7 px")
        require(principal is None or max(map(abs, principal)) <= 1e6, "principal_point must lie within 1e6 px")
        require(principal is None or focal is not None, "a principal_point belongs to a focal length (perspective)")
        power = 1.0 if isinstance(self.transfer, str) else self.transfer
        require(0.1 <= power <= 10, "transfer is linear, srgb, or a power between 0.1 and 10")

    @property
    def origin_px(self) -> tuple[int, int]:
        """Where the region of interest begins."""
        return (0, 0) if self.roi is None else (self.roi[0], self.roi[1])


@dataclass(frozen=True)
class LightParams:
    """Where the light comes from."""

    __pydantic_config__: ClassVar[dict[str, Any]] = FORBID

    sun: Literal["auto", "unknown"] | tuple[float, float, float] = "auto"
    """`[x, y, z]` points towards the Sun, in camera axes: x right, y down, z away from the camera (of a mirrored image
    too); any length. `auto`: from the frame's time and the camera's orientation, where both are known; else unknown.
    A frame's `sun` goes before it."""
    sun_sigma_deg: float = 1.0
    """Standard deviation of that direction, told or computed, about each axis across it."""

    def __post_init__(self) -> None:
        if not isinstance(self.sun, str):
            try:
                unit(self.sun)
            except ValueError as error:
                raise FieldError("sun", str(error)) from error
        if not 0 < self.sun_sigma_deg <= 180:
            raise FieldError("sun_sigma_deg", "must lie in (0, 180]")
