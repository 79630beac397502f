"""How long a frame takes whose session moves to another worker, because its own is killed under it.

    python tests/e2e/move.py [--kills 10]

Two worker processes with the real tracker, 500 particles at 256 px. Before each kill both are up and have the model
prepared, as in a service with several sessions of a model. Every state must be that of an undisturbed run.
"""

import argparse
import asyncio
import json
import os
import signal
import sys
import threading
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

from service.bench.engine_bench import WARM_FRAMES, EnginePlan, Traffic, process_contestants
from service.workers.engine import Engine


async def measure(kills: int) -> dict[str, object]:
    """The times of frames in seconds: undisturbed, and with the worker killed 5 ms after the frame was given to it."""
    traffic = Traffic(EnginePlan(sessions=2, frames=1))
    transport = process_contestants([2])[1].transport()
    engine = Engine(transport)
    await transport.start()
    try:
        await traffic.warm_up(engine)
        calm, struck, expected = [], [], list(traffic.states)
        await traffic.track(engine, 0, WARM_FRAMES, expected)
        for _ in range(kills):
            while len(home_and_others(transport)) < 2:
                await asyncio.sleep(0.05)  # the lost one is starting
            for _ in range(6):  # both sessions at once: each worker tracks, and has the model then
                states = list(traffic.states)
                calm += await asyncio.gather(*(traffic.track(engine, n, WARM_FRAMES, states) for n in range(2)))
            states = list(traffic.states)
            frame = asyncio.create_task(traffic.track(engine, 0, WARM_FRAMES, states))
            await asyncio.sleep(0)  # it has been given to its worker
            busy = next(name for name in home_and_others(transport) if transport._placement.load(name))
            pid = transport._by_name[busy].pid
            threading.Timer(0.005, os.kill, (pid, signal.SIGKILL)).start()
            struck.append(await frame)
            assert states[0] == expected[0], "another answer"
        return {"undisturbed_p50_s": at(calm, 50), "killed_p50_s": at(struck, 50), "killed_max_s": at(struck, 100)}
    finally:
        await transport.close()


def home_and_others(transport) -> tuple[str, ...]:
    """Workers that take jobs."""
    return transport._placement.workers


def at(seconds: list[float], percent: float) -> float:
    """A percentile."""
    return round(float(np.percentile(seconds, percent)), 3)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=10)
    figures = asyncio.run(measure(parser.parse_args().kills))
    print(json.dumps({**figures, "load": os.getloadavg()[0]}, indent=1))


if __name__ == "__main__":
    main()
