"""Which graphics and compute drivers a machine has, and what is missing; standard library only.

A driver needs three things to be used without a display: its libraries, a file that tells the OpenCL loader of it
(``/etc/OpenCL/vendors/*.icd``), and one that tells the EGL loader (``egl_vendor.d/*.json``). Containers often lack the
last two.
"""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import subprocess
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

ICD_FOLDER = "/etc/OpenCL/vendors"
EGL_FOLDERS = ("/etc/glvnd/egl_vendor.d", "/usr/share/glvnd/egl_vendor.d", "/usr/local/nvidia/share/glvnd/egl_vendor.d")
OPENCL_DRIVERS = {  # library -> what it serves
    "libnvidia-opencl.so.1": "NVIDIA",
    "libamdocl64.so": "AMD",
    "libigdrcl.so": "Intel",
}
EGL_DRIVERS = {"libEGL_nvidia.so.0": "NVIDIA"}
LOADERS = {  # library -> what brings it
    "libEGL.so.1": "apt-get install libegl1",
    "libGL.so.1": "apt-get install libgl1",
}


@dataclass
class Drivers:
    """What was found; ``missing`` says what to do about the rest, ``environment`` makes up for missing files."""

    nvidia: str | None = None  # what nvidia-smi says of the GPUs
    nodes: list[str] = field(default_factory=list)  # device files of GPUs
    opencl: dict[str, str] = field(default_factory=dict)  # ICD file -> library, or why it does not load
    egl: dict[str, str] = field(default_factory=dict)  # vendor file -> library, or why it does not load
    missing: list[str] = field(default_factory=list)
    environment: dict[str, str] = field(default_factory=dict)


def find_drivers(made: Path, environment: Mapping[str, str] = os.environ) -> Drivers:
    """Look around. Loader files that are missing are written into the folder ``made``, for this run only."""
    found = Drivers(nvidia=_nvidia_smi(), nodes=_nodes())
    _find_opencl(found, made / "vendors", Path(environment.get("OCL_ICD_VENDORS", ICD_FOLDER)))
    named = environment.get("__EGL_VENDOR_LIBRARY_FILENAMES", "")
    _find_egl(found, made / "egl_vendor.json", named.split(":") if named else _files(EGL_FOLDERS, ".json"))
    for library, remedy in LOADERS.items():
        if (reason := load_error(library)) is not None:
            found.missing.append(f"{reason} ({remedy}): the OpenGL scorer needs it")
    if found.nodes and found.nvidia is None and any("nvidia" in node for node in found.nodes):
        found.missing.append(
            "nvidia-smi does not answer: the driver's tools are not installed, or the driver is broken"
        )
    if not found.nodes:
        found.missing.append(
            "no device file of a GPU (/dev/nvidia*, /dev/dri/renderD*, /dev/kfd): no GPU, or no driver"
        )
    return found


def describe_drivers(found: Drivers) -> list[str]:
    """Lines for people."""
    lines = [f"GPUs (nvidia-smi): {found.nvidia or 'none'}", f"device files: {' '.join(found.nodes) or 'none'}"]
    lines += [f"OpenCL {path}: {state}" for path, state in found.opencl.items()] or ["OpenCL: no ICD file"]
    lines += [f"EGL {path}: {state}" for path, state in found.egl.items()] or ["EGL: no vendor file"]
    lines += [f"missing: {line}" for line in found.missing]
    return lines + [f"set for this run: {name}={value}" for name, value in found.environment.items()]


def load_error(library: str) -> str | None:
    """Why a shared library cannot be loaded; None if it can."""
    try:
        ctypes.CDLL(library)
    except OSError as error:
        return str(error)
    return None


def _find_opencl(found: Drivers, made: Path, folder: Path) -> None:
    files = _files([str(folder)], ".icd")
    for path in files:
        library = Path(path).read_text().strip()
        found.opencl[path] = load_error(library) or library
    known = " ".join(found.opencl.values())
    extra = [name for name in OPENCL_DRIVERS if name not in known and load_error(name) is None]
    if extra:
        made.mkdir(parents=True, exist_ok=True)
        for path in files:
            shutil.copy(path, made)
        for name in extra:
            (made / f"{OPENCL_DRIVERS[name].lower()}.icd").write_text(name + "\n")
            found.missing.append(f"{folder}/{OPENCL_DRIVERS[name].lower()}.icd with the line {name}")
            found.opencl[str(made / f"{OPENCL_DRIVERS[name].lower()}.icd")] = name
        found.environment["OCL_ICD_VENDORS"] = str(made)
    if not found.opencl:
        found.missing.append(f"an ICD file in {folder}: no OpenCL (NVIDIA: libnvidia-opencl1; CPU: pocl-opencl-icd)")
    if found.nvidia and "libnvidia-opencl" not in " ".join(found.opencl.values()):
        found.missing.append(
            "libnvidia-opencl.so.1: in containers set NVIDIA_DRIVER_CAPABILITIES=compute,utility,graphics"
        )


def _find_egl(found: Drivers, made: Path, files: Iterable[str]) -> None:
    for path in files:
        try:
            library = str(json.loads(Path(path).read_text())["ICD"]["library_path"])
            found.egl[path] = load_error(library) or library
        except (OSError, ValueError, KeyError, TypeError) as error:
            found.egl[path] = f"cannot be read: {error}"
    known = " ".join(found.egl.values())
    for name, maker in EGL_DRIVERS.items():
        if name in known or load_error(name) is not None:
            continue
        made.parent.mkdir(parents=True, exist_ok=True)
        made.write_text(json.dumps({"file_format_version": "1.0.0", "ICD": {"library_path": name}}))
        found.missing.append(f"{EGL_FOLDERS[1]}/10_{maker.lower()}.json that names {name}")
        found.environment["__EGL_VENDOR_LIBRARY_FILENAMES"] = ":".join([str(made), *found.egl])
        found.egl[str(made)] = name
    if not found.egl:
        found.missing.append(
            "an EGL vendor file: no OpenGL without a display (NVIDIA: libnvidia-gl; Mesa: libegl-mesa0)"
        )


def _files(folders: Iterable[str], suffix: str) -> list[str]:
    return [str(path) for folder in folders for path in sorted(Path(folder).glob(f"*{suffix}"))]


def _nodes() -> list[str]:
    patterns = ("nvidia[0-9]*", "nvidiactl", "kfd", "dri/renderD*")
    return [str(path) for pattern in patterns for path in sorted(Path("/dev").glob(pattern))]


def _nvidia_smi() -> str | None:
    tool = shutil.which("nvidia-smi")
    if tool is None:
        return None
    query = [tool, "--query-gpu=name,driver_version,memory.total", "--format=csv,noheader"]
    try:
        answer = subprocess.run(query, capture_output=True, text=True, timeout=60, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return "; ".join(answer.stdout.split("\n")).strip("; ") if answer.returncode == 0 else None
