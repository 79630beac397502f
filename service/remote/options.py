"""What the clients' calls take, by name."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal, TypedDict

import httpx

StreamKind = Literal["websocket", "sse"]


class Sections(TypedDict, total=False):
    """Parts of a session's configuration; what is left out comes from the preset."""

    filter: dict[str, Any]
    likelihood: dict[str, Any]
    prior: dict[str, Any]
    motion: dict[str, Any]
    camera: dict[str, Any]
    joints: dict[str, Any]
    light: dict[str, Any]
    background: Literal["posted", "auto"]


class Region(TypedDict, total=False):
    """Where no empty frame exists: what of the image shows only background."""

    box: str
    """``x,y,w,h``: all but this box."""
    border: float
    """Pixels: the margin of this width."""


class FrameFacts(TypedDict, total=False):
    """What is known of a frame. A file's own header serves where this is silent."""

    time: datetime | str
    ra_deg: float
    dec_deg: float
    position_angle_deg: float
    az_deg: float
    el_deg: float
    sun: str
    """``x,y,z`` towards the Sun, in camera axes."""


def http_options(url: str, api_key: str | None, timeout_s: float) -> dict[str, Any]:
    """Of either client of httpx."""
    headers = {"User-Agent": "skypose-client"}
    if api_key is not None:
        headers["Authorization"] = f"Bearer {api_key}"
    return {"base_url": url, "headers": headers, "timeout": httpx.Timeout(timeout_s)}
