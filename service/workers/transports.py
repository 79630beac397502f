"""The transport that the settings name. Nothing of Ray is imported unless it is chosen."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from service.workers.engine import Transport
from service.workers.pool import Batching, ProcessTransport
from service.workers.process import tracker_program


def open_transport(settings: Mapping[str, Any], factory: str | None = None) -> Transport:
    """Of the process's settings; ``factory`` names another worker than the tracker."""
    program = tracker_program(settings, factory)
    batching: Batching = settings["batching"] if factory is None else "off"  # it is the tracker that knows of devices
    return ProcessTransport(program, settings["workers"], settings["worker_timeout_s"], batching)
