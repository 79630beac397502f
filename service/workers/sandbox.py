"""What a decode process gives up for good before the first byte from outside, and which of it this kernel can take.

The files it may still read are those that Python loads code from. Where the kernel has no Landlock to hold it to
them, everything is loaded first and no file is opened again.
"""

from __future__ import annotations

import sysconfig
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import gpu
from service.workers import kernel, landlock, seccomp


@dataclass(frozen=True)
class Sandbox:
    """Measures by name: those that hold, and why the others do not."""

    in_force: tuple[str, ...] = ()
    missing: Mapping[str, str] | None = None  # None: it is switched off

    def __str__(self) -> str:
        if self.missing is None:
            return "off (SKYPOSE_DECODE_SANDBOX)"
        lacking = ", ".join(f"{name} ({why})" for name, why in self.missing.items())
        return ", ".join(self.in_force) + (f"; NOT in force: {lacking}" if lacking else "")


def enter(load_all: Callable[[], None]) -> Sandbox:
    """Give up what can be given up. ``load_all`` imports whatever decoding may need, which takes half a second."""
    in_force: list[str] = ["dies with its parent"]
    missing: dict[str, str] = {}

    def take(name: str, measure: Callable[[], None]) -> bool:
        try:
            measure()
        except OSError as error:
            missing[name] = error.strerror or str(error)
            return False
        in_force.append(name)
        return True

    take("no core dumps", kernel.hide)
    take("no capabilities", kernel.drop_capabilities)
    take("no new privileges", kernel.allow_no_new_privileges)
    reading = take("Landlock", lambda: landlock.restrict(code_paths()))
    if not reading:
        load_all()
    take("seccomp", lambda: seccomp.restrict(reading=reading))
    return Sandbox(tuple(in_force), missing)


def code_paths() -> tuple[Path, ...]:
    """Where Python and the dynamic loader find code: of ours the packages alone, not what may lie beside them."""
    ours = [Path(__file__).parents[1], *map(Path, gpu.__path__)]
    python = [Path(sysconfig.get_path("stdlib")), Path(sysconfig.get_path("platstdlib")), Path(np.__file__).parents[1]]
    shared = ("/lib", "/lib64", "/usr/lib", "/usr/lib64", "/usr/local/lib", "/etc/ld.so.cache")
    return (*ours, *python, *map(Path, shared))
