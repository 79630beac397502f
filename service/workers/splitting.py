"""The job of taking a file of several frames apart."""

from __future__ import annotations

from dataclasses import dataclass

from service.imaging.decode import ByteOrder


@dataclass(frozen=True)
class SplitJob:
    """What ``Tracker.split`` takes; it answers a tuple of ``service.imaging.split.SplitFrame``."""

    body: bytes
    media_type: str
    ser_byte_order: ByteOrder = "auto"
