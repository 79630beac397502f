"""Worker processes: a death, a hang or a bug costs a retry or an answer, never the service."""

import asyncio
import os
import pickle
import signal
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from fake_worker import FakeWorker

from service.errors import ImageError, SkyposeError, StoppingError, WorkerFailedError
from service.workers.child_process import Program
from service.workers.interpreter import Interpreter
from service.workers.pool import ProcessTransport
from service.workers.process import WorkerProcess
from service.workers.spare import Spare

pytestmark = pytest.mark.anyio
FACTORY_OF_AWKWARD = "test_process:Awkward"


class Awkward(FakeWorker):
    """Does to its process what a job says."""

    woken = False

    def wake(self):
        self.woken = True

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
        if job == "woken":
            return self.woken
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
async def worker(factory: str = FACTORY_OF_AWKWARD, timeout_s: float = 60.0):
    process = WorkerProcess("w", Program(factory), timeout_s)
    await process.start()
    try:
        yield process
    finally:
        await process.close()


async def test_job_and_description():
    async with worker() as process:
        assert await process.call("overlay", "pid") == process.pid != os.getpid()
        assert (await process.call("describe", None))["scorer"] == "fake"


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
        with pytest.raises(WorkerFailedError) as refusal:
            await process.call("overlay", "stop")
        assert process.restarts == 1  # it was not tried again
        assert refusal.value.facts == {"limit": 0.5, "setting": "SKYPOSE_WORKER_TIMEOUT_S"}
        process._timeout_s = 60.0  # half a second is little for a good answer of a busy machine
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
    process = WorkerProcess("w", Program("test_process:Stillborn"), 60.0)
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
    transport = ProcessTransport(Program(FACTORY_OF_AWKWARD), 2, 60.0)
    try:
        await transport.start()
        keys = "abcdefgh" * 3
        pids = await asyncio.gather(*(transport.call(key, "overlay", "pid") for key in keys))
        assert sorted(pids.count(pid) for pid in set(pids)) == [12, 12]
        assert len(set(zip(keys, pids, strict=True))) == 8  # no session was torn apart
        assert await transport.call(None, "overlay", "pid") not in pids
    finally:
        await transport.close()


async def test_who_comes_seventh_is_second_where_the_others_are_one_tenant():
    transport, order = ProcessTransport(Program(FACTORY_OF_AWKWARD), 1, 60.0), []

    async def call(tenant: str, n: int) -> None:
        await transport.call(f"{tenant}/{n}", "overlay", None)
        order.append(tenant)

    await transport.start()
    try:
        await asyncio.gather(*(call("hostile", n) for n in range(6)), call("good", 0))
    finally:
        await transport.close()
    assert order == ["hostile", "good", *["hostile"] * 5]


async def test_spare_takes_the_place_of_one_that_is_lost():
    spare = Spare(Program(FACTORY_OF_AWKWARD))
    process = WorkerProcess("w", Program(FACTORY_OF_AWKWARD), 60.0, spare)
    try:
        await process.start()
        spare.fill()
        ready = spare._next.result()
        os.kill(process.pid, signal.SIGKILL)
        assert await process.call("overlay", "pid") == ready.pid
        os.kill(spare._next.result().pid, signal.SIGKILL)  # nobody notices that the next spare is gone
        os.kill(process.pid, signal.SIGKILL)
        assert await process.call("overlay", "pid") not in (None, ready.pid)
        assert process.restarts == 2
    finally:
        await process.close()
        spare.close()


async def test_an_interpreter_that_was_started_ahead_is_the_first_worker():
    first = Interpreter("fake_worker")
    process = WorkerProcess("w", Program(FACTORY_OF_AWKWARD), 60.0, first=first)
    try:
        assert await process.call("overlay", "pid") == first.process.pid
        os.kill(process.pid, signal.SIGKILL)
        assert await process.call("overlay", "pid") not in (None, first.process.pid)
    finally:
        await process.close()


def test_an_interpreter_that_is_not_needed_ends_by_itself():
    interpreter = Interpreter()
    interpreter.channel.close()
    assert interpreter.process.wait() == 0


async def test_a_spare_is_woken_when_it_is_taken():
    spare = Spare(Program(FACTORY_OF_AWKWARD))
    process = WorkerProcess("w", Program(FACTORY_OF_AWKWARD), 60.0, spare)
    spare.fill()
    try:
        asleep = spare._next.result()
        assert asleep.exchange(pickle.dumps(("overlay", "woken")), 60.0) is False
        assert await process.call("overlay", "woken") is True
        assert process.pid == asleep.pid
    finally:
        await process.close()
        spare.close()


async def test_spare_that_cannot_be_built_is_done_without():
    spare = Spare(Program("test_process:Stillborn"))
    spare.fill()
    assert spare.take() is None
    spare.close()
    spare.fill()
    assert spare.take() is None


async def test_job_of_a_lost_worker_goes_to_another_while_it_starts_again(tmp_path):
    transport = ProcessTransport(Program(FACTORY_OF_AWKWARD), 2, 60.0)
    try:
        await transport.start()
        first = await transport.call("a", "overlay", "pid")
        pids = {process["name"]: process["pid"] for process in transport.processes()}
        second = await transport.call("a", "overlay", ("once", str(tmp_path / "marks")))
        assert first != second == next(pids[name] for name in ("track-0", "track-1") if pids[name] != first)
        assert await transport.call("a", "overlay", "pid") == second
        with pytest.raises(WorkerFailedError):
            await transport.call("a", "overlay", "die")
        assert transport.restarts == 3
        assert await transport.call("a", "overlay", "pid")
    finally:
        await transport.close()
