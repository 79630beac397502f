"""What can go wrong with a scorer.

ScorerError
├── DeviceError          no usable OpenCL device
│   └── DeviceLostError  the device failed or disappeared during a call
└── ImageSizeError       the map is larger than a scorer can take
"""

from __future__ import annotations


class ScorerError(RuntimeError):
    """A scorer cannot be opened or used; the message says why."""


class DeviceError(ScorerError):
    """No OpenCL device can be used."""


class DeviceLostError(DeviceError):
    """The device failed or disappeared during a call; the scorer is dead, open another."""


class ImageSizeError(ScorerError):
    """The map is larger than a scorer can take: ``limit`` px a side."""

    def __init__(self, message: str, limit: int) -> None:
        super().__init__(message)
        self.limit = limit
