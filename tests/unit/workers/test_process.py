"""Worker processes: a death, a hang or a bug costs a retry or an answer, never the service."""

import asyncio
import os
import signal
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from fake_worker import FakeWorker

from service.errors import ImageError, SkyposeError, StoppingError, WorkerFailedError
from service.workers.pool import ProcessTransport
from service.workers.process import WorkerProcess

pytestmark = pytest.mark.anyio
FACTORY = "fake_worker:FakeWorker"
HERE = f"{__name__}:"


class Awkward(FakeWorker):
    """Does to its process what a job says."""

    def overlay(self, job):
        if job == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        if job == "stop":
            os.kill(os.getpid(), signal.SIGSTOP)
        if job == "memory":
            raise MemoryError
        if job == "device":
            raise type("RuntimeError", (Exception,), {"__module__": "pyopencl._cl"})("CL_DEVICE_NOT_AVAILABLE")
        if job == "bug":
            raise ZeroDivisionError
        if job == "refuse":
            raise ImageError("broken", field="body", limit=3)
        if isinstance(job, tuple):  # ("once", path): die, but only the first time
            with Path(job[1]).open("a") as marks:
                marks.write(".")
            if Path(job[1]).stat().st_size == 1:
                os.kill(os.getpid(), signal.SIGKILL)
        return os.getpid()


class Stillborn(FakeWorker):
    def __init__(self):
        raise RuntimeError("no device")


@asynccontextmanager
async def worker(factory: str = "test_process:Awkward", timeout_s: float = 60.0):
    process = WorkerProcess("w", factory, timeout_s, 60.0)
    await process.start()
    try:
        yield process
    finally:
        await process.close()


async def test_job_and_description():
    async with worker() as process:
        assert await process.call("overlay", "pid") == process.pid != os.getpid()
        assert process.description["scorer"] == "fake"


async def test_death_in_a_job_is_retried(tmp_path):
    async with worker() as process:
        first = process.pid
        assert await process.call("overlay", ("once", str(tmp_path / "marks"))) == process.pid != first
        assert process.restarts == 1


async def test_death_between_jobs_is_not_noticed_by_the_caller():
    async with worker() as process:
        os.kill(process.pid, signal.SIGKILL)
        assert await process.call("overlay", "pid") == process.pid


@pytest.mark.parametrize("job", ["die", "memory", "device"])
async def test_job_that_kills_twice_is_refused(job):
    async with worker() as process:
        with pytest.raises(WorkerFailedError):
            await process.call("overlay", job)
        assert process.restarts == 2
        assert await process.call("overlay", "pid")


async def test_hang_is_ended():
    async with worker(timeout_s=0.5) as process:
        with pytest.raises(WorkerFailedError):
            await process.call("overlay", "stop")
        assert await process.call("overlay", "pid")


async def test_refusal_keeps_its_facts_and_the_process():
    async with worker() as process:
        with pytest.raises(ImageError) as refusal:
            await process.call("overlay", "refuse")
        assert (refusal.value.detail, refusal.value.field, refusal.value.facts) == ("broken", "body", {"limit": 3})
        assert process.restarts == 0


async def test_bug_is_an_internal_error_and_leaves_the_process():
    async with worker() as process:
        with pytest.raises(SkyposeError) as refusal:
            await process.call("overlay", "bug")
        assert type(refusal.value) is SkyposeError
        assert "ZeroDivision" not in str(refusal.value)
        assert process.restarts == 0


async def test_worker_that_cannot_be_built_says_why():
    process = WorkerProcess("w", "test_process:Stillborn", 60.0, 60.0)
    with pytest.raises(WorkerFailedError, match="no device"):
        await process.start()
    await process.close()


async def test_close_finishes_the_job_in_hand():
    async with worker() as process:
        job = asyncio.create_task(process.call("overlay", "pid"))
        await asyncio.sleep(0)
        await process.close()
        assert await job
        with pytest.raises(StoppingError):
            await process.call("overlay", "pid")


async def test_sessions_are_spread_and_the_side_is_apart():
    transport = ProcessTransport("test_process:Awkward", 2, 60.0, 60.0)
    try:
        await transport.start()
        keys = "abcdefgh" * 3
        pids = await asyncio.gather(*(transport.call(key, "overlay", "pid") for key in keys))
        assert sorted(pids.count(pid) for pid in set(pids)) == [12, 12]
        assert len(set(zip(keys, pids, strict=True))) == 8  # no session was torn apart
        assert await transport.call(None, "overlay", "pid") not in pids
    finally:
        await transport.close()
