"""Which OpenGL this machine has, and how its pictures would get to OpenCL.

Found out in a process of its own: a driver that crashes, or that does not go with OpenCL's in one process, harms nobody
who never asked for OpenGL.
"""

from __future__ import annotations

import functools
import json
import subprocess
import sys
from dataclasses import dataclass

import pyopencl as cl

from gpu.device import DeviceReport, find_devices, no_device_reason
from gpu.gl_memory import has_buffer_storage
from gpu.interop import HandOverChoice, choose_hand_over

LONGEST_S = 20.0
PROBE = """
import json, moderngl
gl = moderngl.create_context(standalone=True, require=330, backend="egl")
print(json.dumps([gl.info["GL_RENDERER"], gl.version_code, sorted(gl.extensions)]))
"""


@dataclass(frozen=True)
class OpenGLReport:
    """What OpenGL without a display says of itself."""

    renderer: str = ""
    version_code: int = 0
    extensions: tuple[str, ...] = ()
    rejected: str | None = None  # why it cannot be used


@functools.cache
def find_opengl() -> OpenGLReport:
    """Look once per process."""
    command = [sys.executable, "-c", PROBE]
    try:
        probe = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST_S, check=False)
    except subprocess.TimeoutExpired:
        return OpenGLReport(rejected=f"OpenGL did not answer within {LONGEST_S:g} s")
    if probe.returncode < 0:
        return OpenGLReport(rejected=f"OpenGL's driver ended its process by signal {-probe.returncode}")
    if probe.returncode > 0:
        last = probe.stderr.strip().splitlines()[-1:]
        return OpenGLReport(rejected=f"no OpenGL 3.3 through EGL: {''.join(last)}")
    renderer, version_code, extensions = json.loads(probe.stdout.splitlines()[-1])
    return OpenGLReport(renderer, version_code, tuple(extensions))


def expected_hand_over() -> HandOverChoice:
    """What the backend ``opengl`` would use on the best device, and why nothing better; ``none``: it cannot run."""
    usable = [report for report in find_devices() if report.rejected is None]
    if not usable:
        return HandOverChoice("none", no_device_reason())
    return hand_over_between(find_opengl(), usable[0])


def hand_over_between(opengl: OpenGLReport, device: DeviceReport) -> HandOverChoice:
    """The same for this OpenGL and this device."""
    if opengl.rejected is not None:
        return HandOverChoice("none", opengl.rejected)
    return choose_hand_over(cl.have_gl(), device.kind, device.extensions, has_buffer_storage(opengl))
