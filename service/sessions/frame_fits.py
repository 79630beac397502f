"""A frame as FITS with its pose in ``POSE_*`` cards: its own file where it came as FITS."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import orjson

from service.imaging.decode import FITS, decode_frame
from service.imaging.headers import media_kind
from service.imaging.limits import DEFAULT_LIMITS
from service.imaging.split import PNG

_ELEMENTS = {"W": "w", "X": "x", "Y": "y", "Z": "z"}


def is_fits(media_type: str) -> bool:
    """Whether a frame came as FITS, so that its own file can be given back."""
    return media_kind(media_type) in FITS


def original_with_pose(body: bytes, document: bytes) -> bytes:
    """A frame's own FITS file plus cards: every other byte of it as it was."""
    from service.imaging.formats.fits_cards import with_cards  # astropy, when it is needed

    return with_cards(body, pose_cards(orjson.loads(document)), limit=16 * DEFAULT_LIMITS.pixels)


def image_with_pose(png: bytes, document: bytes) -> bytes:
    """A new FITS file of a frame that came in another format, given as PNG by a worker."""
    from service.imaging.formats.fits_image import fits_of_image  # astropy, when it is needed

    estimate = orjson.loads(document)
    return fits_of_image(decode_frame(png, PNG).image, estimate["time"], pose_cards(estimate))


def pose_cards(estimate: Mapping[str, Any]) -> list[tuple[str, str | float | int, str]]:
    """The best pose of an estimate as keyword, value and comment."""
    best = estimate["best"]
    attitude = best.get("attitude")
    turns = [(f"POSE_Q{axis}", best["orientation"][key], "body -> camera") for axis, key in _ELEMENTS.items()]
    if attitude is not None:
        turns += [(f"POSE_G{axis}", attitude["orientation"][key], "body -> GCRF") for axis, key in _ELEMENTS.items()]
    joints = sorted(best["joints"].items())
    return [
        ("POSE_IDX", estimate["index"], "skypose frame number"),
        ("POSE_STA", estimate["status"], "status of the answer"),
        *turns,
        ("POSE_X", best["x_px"], "[pix] from the left edge of the image"),
        ("POSE_Y", best["y_px"], "[pix] from the top edge of the image"),
        ("POSE_SC", best["scale_px"], "[pix] per model unit"),
        ("POSE_SPR", estimate["spread"]["orientation_deg"], "[deg] spread of the orientation"),
        *((f"POSE_N{k}", name.encode("ascii", "replace").decode()[:60], "joint") for k, (name, _) in enumerate(joints)),
        *((f"POSE_J{k}", value, "[deg] or model units") for k, (_, value) in enumerate(joints)),
    ]
