"""The side of a worker process: build the worker, run jobs one at a time, end when the parent does."""

from __future__ import annotations

import gc
import importlib
import pickle
import signal
import traceback
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection
from typing import Any, Literal

from service.errors import SkyposeError
from service.inference.state import FilterState
from service.workers.base import PackedFrameJob, PackedFrameReport, Worker
from service.workers.codec import decode, encode
from service.workers.kernel import return_memory

Outcome = Literal["done", "refused", "bug", "broken"]


def execute(worker: Worker, method: str, job: Any) -> Any:
    """Run one job. A frame's state is unpacked and packed here, so that nobody outside touches its arrays."""
    if method == "wake":
        return worker.wake()
    if method == "describe":
        return dict(worker.describe())
    if method == "track":
        return _track(worker, job)
    return getattr(worker, method)(job)


def _track(worker: Worker, packed: PackedFrameJob) -> PackedFrameReport:
    state = None if packed.state is None else decode(FilterState, packed.state)
    report = worker.track(replace(packed.job, state=state))
    belief = None if report.belief is None else encode(report.belief)
    return PackedFrameReport(encode(report.state), report.estimate, dict(report.timing_ms), report.scorer, belief)


def load_factory(path: str) -> Callable[..., Worker]:
    """``package.module:name`` -> the callable that builds a worker."""
    module, _, name = path.partition(":")
    factory: Callable[..., Worker] = getattr(importlib.import_module(module), name)
    return factory


def serve(channel: Connection, factory: str, arguments: tuple[Any, ...] = ()) -> None:
    """Body of a worker process. First message out: ``("done", None)`` when ready."""
    # Ctrl-C and a supervisor's SIGTERM reach the whole group; the parent finishes its frames first.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    worker: Worker | None = None
    ready = False
    try:
        worker = load_factory(factory)(*arguments)
        gc.freeze()  # what stays for good is never looked at; the imports leave next to no garbage
        return_memory()  # of the kernels' compiler: twelve megabytes
        gc.enable()
        channel.send_bytes(pickle.dumps(("done", None)))
        ready = True
        while (message := channel.recv_bytes()) != b"":
            outcome = _answer(worker, message)
            channel.send_bytes(pickle.dumps(outcome, protocol=5))
    except EOFError:
        return
    except Exception:
        if not ready:
            channel.send_bytes(pickle.dumps(("broken", traceback.format_exc())))
        raise
    finally:
        if worker is not None:
            worker.close()


def _answer(worker: Worker, message: bytes) -> tuple[Outcome, Any]:
    method, job = pickle.loads(message)
    try:
        return "done", execute(worker, method, job)
    except SkyposeError as error:
        return "refused", error
    except MemoryError:
        return "broken", traceback.format_exc()
    except Exception as error:  # noqa: BLE001 -- the parent hears of it, whatever it is
        lost_device = type(error).__module__.partition(".")[0] == "pyopencl"
        return "broken" if lost_device else "bug", traceback.format_exc()
