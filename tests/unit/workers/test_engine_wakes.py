"""What a worker that wakes is given to prepare: the bodies that were tracked last, with their bytes."""

import pytest

from service.errors import ImageError, MissingBlobError
from service.inference.articulation import Articulation
from service.inference.params import SessionConfig
from service.workers.base import FrameJob
from service.workers.engine import Engine
from service.workers.placement import KNOWN_MODELS

pytestmark = pytest.mark.anyio


class Transport:
    """Takes every job."""

    def on_wake(self, prepare):
        self.prepare = prepare

    async def call(self, key, method, job):
        return None


def frame(model: str) -> FrameJob:
    return FrameJob(SessionConfig(), model, "glb", Articulation(("body",)), "sky", None, 0, 0.0, b"", "image/png")


async def blob(key: str) -> bytes:
    return key.encode()


async def test_the_last_bodies_are_prepared_with_their_bytes():
    transport, jobs = Transport(), []
    engine = Engine(transport)
    for k in [*range(KNOWN_MODELS), 1, KNOWN_MODELS]:
        await engine.track("s", frame(f"m{k}"), None, blob)

    async def run(method, job):
        if job.model not in job.blobs:
            raise MissingBlobError.of([job.model])
        if job.model == "m3":
            raise ImageError("cannot be prepared")
        jobs.append((method, job.model, job.blobs[job.model]))

    expected = [f"m{k}" for k in (2, 4, 5, 6, 7, 1, KNOWN_MODELS)]  # the first was tracked longest ago
    assert await transport.prepare(run) == expected
    assert jobs == [("ready", model, model.encode()) for model in expected]
