"""The transport that the settings name. Nothing of Ray is imported unless it is chosen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from service.errors import ConfigError
from service.workers.child_process import Program
from service.workers.engine import Transport
from service.workers.interpreter import Interpreter
from service.workers.pool import Batching, ProcessTransport
from service.workers.process import TRACKER, tracker_program
from service.workers.room import workers_that_fit

NODE_KERNELS = Path("~/.cache/skypose/kernels")  # of a machine that has no folder of the service's


def open_transport(
    settings: Mapping[str, Any], factory: str | None = None, first: Interpreter | None = None
) -> Transport:
    """Of the process's settings; ``factory`` names another worker than the tracker, ``first`` was started for one.

    Raises ``ConfigError`` for Ray where it is not installed.
    """
    program = tracker_program(settings, factory)
    batching: Batching = settings["batching"] if factory is None else "off"  # it is the tracker that knows of devices
    if settings["engine"] == "ray":
        if first is not None:
            first.close()  # Ray starts its own
        return _ray(settings, program, batching)
    count, timeout_s = settings["workers"], settings["worker_timeout_s"]
    if count:
        return ProcessTransport(program, count, timeout_s, batching, first=first)
    return ProcessTransport(program, workers_that_fit(), timeout_s, "off", first=first, awake=1)


def _ray(settings: Mapping[str, Any], program: Program, batching: Batching) -> Transport:
    try:
        from service.workers.ray_engine import RayPlan, RayTransport
        from service.workers.ray_worker import WorkerPlan
    except ModuleNotFoundError as error:
        raise ConfigError("the engine ray needs Ray: pip install 'ray>=2.40'", field="SKYPOSE_ENGINE") from error
    if program.factory == TRACKER:
        program = replace(program, arguments=(program.arguments[0], NODE_KERNELS))
    cores = settings["ray_cores"]
    worker = WorkerPlan(program, settings["workers"] or 1, settings["worker_timeout_s"], batching, cores)
    plan = RayPlan(settings["ray_address"], settings["ray_actors"], cores, settings["worker_start_timeout_s"])
    return RayTransport(plan, worker)
