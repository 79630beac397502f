"""``skypose bench start``: how soon a service is ready, and what memory it takes when idle."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

_HOST = "127.0.0.1"


def start(
    repeats: Annotated[int, typer.Option(min=1, help="Starts that count; one before them builds the kernels.")] = 7,
    json: Annotated[Path | None, typer.Option("--json", help="Write the rows as JSON.")] = None,
) -> None:
    """Time until a service of its own is ready, and the memory of its processes. SKYPOSE_... hold for it."""
    import time
    from contextlib import suppress
    from tempfile import TemporaryDirectory

    from service.bench.machine import describe_machine
    from service.bench.start import Memory, Start, computed_s, memory_of, start_document, start_tables, wait_until_idle
    from service.cli.bench_load import load_refusals
    from service.cli.bench_output import publish
    from service.cli.demo_service import ServiceProcess, free_port

    starts: list[Start] = []
    memory: list[Memory] = []
    with load_refusals(), TemporaryDirectory(prefix="skypose-start-") as folder:
        for n in range(repeats + 1):
            began = time.perf_counter()
            with ServiceProcess(_HOST, free_port(_HOST), Path(folder)) as service:
                ready_s = time.perf_counter() - began
                if n > 0:
                    starts.append(Start(1e3 * ready_s, 1e3 * computed_s(service.pid)))
                    typer.echo(f"start {n}: ready after {starts[-1].ready_ms:.0f} ms", err=True)
                wait_until_idle(service.pid)  # so that nothing of this start runs beside the next one
                if n == repeats:
                    with suppress(PermissionError):
                        memory = memory_of(service.pid)
    document = start_document(describe_machine(), starts, memory)
    publish(document, start_tables(document), None, json, None)
