"""``deploy/gpu-check``: drivers, devices, the GPU tests, both benchmarks and agreement, in one report."""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from service.bench.drivers import Drivers, describe_drivers, find_drivers

ROOT = Path(__file__).resolve().parents[2]
PASSED, FAILED, NO_GPU = 0, 1, 3
BENCHMARKS = ("scorers", "step", "light")
LONGEST_S = 3600.0
LIST_DEVICES = """
import json, sys
from dataclasses import asdict
import pyopencl as cl
from gpu.device import find_devices
json.dump({"have_gl": cl.have_gl(), "devices": [asdict(report) for report in find_devices()]}, sys.stdout)
"""


@dataclass(frozen=True)
class Check:
    """One thing that was run; what it printed is in ``log``."""

    name: str
    command: str
    status: int
    seconds: float
    log: str
    last_line: str


def main(arguments: Sequence[str] | None = None) -> int:
    """Run everything. 0: all is well; 1: a test failed or a scorer disagrees with the reference; 3: no GPU."""
    parser = argparse.ArgumentParser(prog="deploy/gpu-check", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/gpu-check"), help="folder of the report")
    parser.add_argument(
        "--allow-cpu", action="store_true", help="go on without a GPU, on whatever OpenCL device there is"
    )
    parser.add_argument("--quick", action="store_true", help="short benchmarks")
    options = parser.parse_args(arguments)
    out: Path = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    drivers = find_drivers(out)
    environment = {**os.environ, **drivers.environment}
    found, why = list_devices(environment)
    usable = [d for d in found.get("devices", ()) if d["rejected"] is None]
    gpus = [d["name"] for d in usable if d["kind"] == "gpu"]
    verdict = [f"GPU: {', '.join(gpus)}"] if gpus else [f"no GPU found that OpenCL can use{why and f' ({why})'}"]
    checks: list[Check] = []
    if gpus or (options.allow_cpu and usable):
        checks = [run_check(name, command, out, environment) for name, command in plan(out, options.quick, gpus)]
        verdict += verdict_of(checks, rows_of(out / "scorers.json"))
        status = FAILED if any(line.startswith("FAILED") for line in verdict) else PASSED
    else:
        verdict.append("nothing was run; --allow-cpu runs everything on a CPU's OpenCL device")
        status = NO_GPU
    write_report(out, status, verdict, drivers, found, checks)
    print((out / "report.txt").read_text(), end="")  # noqa: T201 -- this is the command's output
    return status


def list_devices(environment: Mapping[str, str]) -> tuple[dict[str, Any], str]:
    """OpenCL devices as a fresh process sees them, and why there are none."""
    answer = subprocess.run(
        [sys.executable, "-c", LIST_DEVICES], cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    if answer.returncode != 0:
        lines = answer.stderr.strip().splitlines()
        return {}, lines[-1] if lines else f"the search for devices ended with status {answer.returncode}"
    found: dict[str, Any] = json.loads(answer.stdout)
    rejected = [f"{d['name']}: {d['rejected']}" for d in found["devices"] if d["rejected"]]
    return found, "; ".join(rejected)


def plan(out: Path, quick: bool, gpus: Sequence[str] = ()) -> list[tuple[str, list[str]]]:
    """What is run, by name; the light on a GPU where there is one."""
    bench = [sys.executable, "-m", "service", "bench"]
    tail = ["--quick"] if quick else []
    plots = find_spec("matplotlib") is not None
    found = [("tests", [sys.executable, "-m", "pytest", "tests/gpu", "-p", "no:cacheprovider", "-rs"])]
    for name in BENCHMARKS:
        (out / f"{name}.json").unlink(missing_ok=True)  # of an earlier run
        if name == "light":
            more = ["--device", "gpu"] if gpus else []
        else:
            more = ["--plot", str(out / f"{name}.png")] if plots else []
        found.append((name, [*bench, name, "--json", str(out / f"{name}.json"), *more, *tail]))
    return found


def run_check(name: str, command: Sequence[str], out: Path, environment: Mapping[str, str]) -> Check:
    """Run one thing; what it prints goes into a file."""
    print(f"gpu-check: {name} …", file=sys.stderr, flush=True)  # noqa: T201 -- progress
    log = out / f"{name}.log"
    began = time.perf_counter()
    with log.open("w") as file:
        try:
            status = subprocess.run(
                command,
                cwd=ROOT,
                env=environment,
                stdout=file,
                stderr=subprocess.STDOUT,
                timeout=LONGEST_S,
                check=False,
            ).returncode
        except subprocess.TimeoutExpired:
            status = 124
    lines = [line for line in log.read_text(errors="replace").splitlines() if line.strip()]
    seconds = round(time.perf_counter() - began, 1)
    return Check(name, " ".join(command), status, seconds, log.name, lines[-1] if lines else "")


def rows_of(path: Path) -> list[dict[str, Any]]:
    """The rows of a benchmark; none if it did not get that far."""
    return list(json.loads(path.read_text())["rows"]) if path.exists() else []


def verdict_of(checks: Sequence[Check], scorer_rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Lines for people; those of failures begin with FAILED."""
    lines = []
    for check in checks:
        ended = "passed" if check.status == 0 else f"FAILED with status {check.status}"
        said = f"{check.name} {ended} in {check.seconds} s: {check.last_line}"
        lines.append(said if check.status == 0 else f"FAILED: {said}")
    for row in scorer_rows:
        if not row["agrees"]:
            error = f"{row['max_rel_error']:.1e} at {row['faces']} faces, {row['size_px']} px"
            lines.append(f"FAILED: {row['backend']} disagrees with the reference: {error}")
    if scorer_rows and all(row["agrees"] for row in scorer_rows):
        lines.append(f"{len({row['backend'] for row in scorer_rows})} scorers agree with the reference")
    return lines


def write_report(
    out: Path, status: int, verdict: Sequence[str], drivers: Drivers, found: Mapping[str, Any], checks: Sequence[Check]
) -> None:
    """``report.json`` and ``report.txt``, with the benchmarks' tables in it."""
    benchmarks = {n: json.loads((out / f"{n}.json").read_text()) for n in BENCHMARKS if (out / f"{n}.json").exists()}
    document = {
        "status": status,
        "verdict": list(verdict),
        "machine": platform.platform(),
        "python": platform.python_version(),
        "drivers": asdict(drivers),
        **found,
        "checks": [asdict(check) for check in checks],
        **benchmarks,
    }
    (out / "report.json").write_text(json.dumps(document, indent=2) + "\n")
    gl = "with" if found.get("have_gl") else "without"
    lines = ["skypose gpu-check", *verdict, "", *describe_drivers(drivers), f"pyopencl: {gl} GL sharing"]
    for device in found.get("devices", ()):
        state = (
            device["rejected"]
            or f"usable, {'with' if 'cl_khr_gl_sharing' in device['extensions'] else 'without'} gl_sharing"
        )
        lines.append(f"{device['kind']} {device['name']} on {device['platform']}: {state}")
    for check in checks:
        if check.name != "tests" or check.status != 0:
            lines += ["", f"== {check.name}", (out / check.log).read_text(errors="replace").rstrip()]
    (out / "report.txt").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    sys.exit(main())
