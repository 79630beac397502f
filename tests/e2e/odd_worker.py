"""A worker that does to its process, and to the actor that holds it, what a job says."""

import os
import signal
from pathlib import Path

from service.errors import ImageError, MissingBlobError


class Odd:
    """See ``fake_worker`` for a whole worker."""

    def describe(self):
        return {}

    def wake(self):
        pass

    def close(self):
        pass

    def overlay(self, job):
        if job == "refuse":
            raise ImageError("broken", field="body", limit=3)
        if job == "missing":
            raise MissingBlobError.of(["key"])
        if job == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        if isinstance(job, tuple):  # ("once", path, …): the actor dies, but only the first time
            with Path(job[1]).open("a") as marks:
                marks.write(".")
            if Path(job[1]).stat().st_size == 1:
                os.kill(os.getppid(), signal.SIGKILL)
        return os.getpid()
