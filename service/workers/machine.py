"""What a worker's machine has, for people."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

from gpu.device import find_devices
from gpu.opengl_probe import expected_hand_over, find_opengl
from gpu.scorer import BACKENDS

PACKAGES = (
    "skypose",
    "numpy",
    "scipy",
    "pyopencl",
    "moderngl",
    "trimesh",
    "opencv-python-headless",
    "fastapi",
)


def describe_machine() -> Mapping[str, Any]:
    """Devices, backends of the scorer, how OpenGL would hand over to OpenCL, and versions."""
    return {
        "backend": "auto",  # of sessions that name none
        "backends": list(BACKENDS),
        "hand_over": {**asdict(expected_hand_over()), "opengl": find_opengl().renderer or None},
        "devices": [asdict(report) for report in find_devices()],
        "versions": {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
    }
