"""A frame's own FITS file with its pose in ``POSE_*`` cards."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import orjson

from service.errors import ConflictError
from service.imaging.decode import FITS
from service.imaging.headers import media_kind
from service.imaging.limits import DEFAULT_LIMITS

_ELEMENTS = {"W": "w", "X": "x", "Y": "y", "Z": "z"}


def frame_fits(body: bytes, media_type: str, document: bytes) -> bytes:
    """The original file plus cards. Raises ``ConflictError`` for a frame that was sent in another format."""
    if media_kind(media_type) not in FITS:
        raise ConflictError(f"the frame was sent as {media_type}, not as FITS", field="index")
    from service.imaging.formats.fits_cards import with_cards  # astropy, when it is needed

    return with_cards(body, pose_cards(orjson.loads(document)), limit=16 * DEFAULT_LIMITS.pixels)


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
        ("POSE_STA", estimate["status"], "acquiring, tracking, lost, no_target"),
        *turns,
        ("POSE_X", best["x_px"], "[pix] from the left edge of the image"),
        ("POSE_Y", best["y_px"], "[pix] from the top edge of the image"),
        ("POSE_SC", best["scale_px"], "[pix] per model unit"),
        ("POSE_SPR", estimate["spread"]["orientation_deg"], "[deg] spread of the orientation"),
        *((f"POSE_N{k}", name.encode("ascii", "replace").decode()[:60], "joint") for k, (name, _) in enumerate(joints)),
        *((f"POSE_J{k}", value, "[deg] or model units") for k, (_, value) in enumerate(joints)),
    ]
