"""The clock of a process and its children, to be stepped while they run: ``stepped_clock.c``, preloaded."""

import mmap
import shutil
import struct
import subprocess
from pathlib import Path

from histories import MissingError

SOURCE = Path(__file__).with_suffix(".c")


def compiled(folder: Path) -> Path:
    """The library. Raises ``MissingError`` where there is no compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        raise MissingError("no clocks to step: `cc` is missing (Debian: apt-get install gcc libc6-dev)")
    library = folder / "stepped_clock.so"
    command = [compiler, "-O2", "-Wall", "-Werror", "-shared", "-fPIC", "-o", str(library), str(SOURCE), "-ldl"]
    subprocess.run(command, check=True)
    return library


class Clock:
    """One, at the true time until it is stepped. ``environment`` gives it to a process that is started."""

    def __init__(self, folder: Path, name: str, library: Path) -> None:
        file = folder / f"{name}.clock"
        file.write_bytes(bytes(8))
        with file.open("r+b") as given:
            self._page = mmap.mmap(given.fileno(), 8)
        self.environment = {"LD_PRELOAD": str(library), "STEPPED_CLOCK": str(file)}

    def step(self, off_s: float) -> None:
        """Be so far off the true time from now on."""
        self._page[:] = struct.pack("d", off_s)
