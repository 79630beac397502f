"""A million particles in bounded memory, on the device and on the host, in a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from step_cases import Case

HERE = Path(__file__).resolve().parent
PEAK_BYTES = 1.3e9  # beyond what the libraries took before the first particle
STEP = """
import resource
import numpy as np
from gpu_cases import a_map
from step_cases import Case, particles_of, poses_of
from service.inference.params import FilterParams, SessionConfig
from service.inference.state import FilterState, Frame, Measurement
from service.inference.step import step
from service.inference.weights import normalise
from service.workers.scoring import TimedScorer

case, n = Case(), 1_000_000
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
particles = case.step.upload(particles_of(case.prior(n), np.full(n, -np.log(n))))
values, jitter = a_map(np.random.default_rng(0)), np.array([0.02] * 8)
for resampler in ("multinomial", "systematic"):
    particles, summary = case.step.run(1, 0, particles, values, jitter, resampler, 0.001)
assert 1 < summary.ess < n, summary
found = case.step.download(particles)
assert abs(np.exp(found.log_weights).sum() - 1) < 1e-4

state = FilterState(poses_of(found), normalise(found.log_weights)[0], np.zeros((n, 8)), 0, 0.0, "tracking")
config = SessionConfig(FilterParams(method="bootstrap", particles=n, step="host"))
frame, score = Frame(1, 0.1, Measurement(values, 0.0)), TimedScorer(case.scorer, case.domain.articulation, values)
state, estimate = step(np.random.default_rng(0), state, frame, score, config, case.domain)
assert 1 < estimate.ess < n, estimate
print(1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before))
"""


@pytest.mark.long
def test_a_million_particles_have_a_bound():
    assert Case().step.name  # skips where no device answers
    given = os.environ.get("PYTHONPATH", "")  # deploy/gpu-check finds the packages by it
    paths = os.pathsep.join([str(HERE.parent.parent), str(HERE), *filter(None, [given])])
    run = subprocess.run(
        [sys.executable, "-c", STEP],
        env=os.environ | {"PYTHONPATH": paths},
        capture_output=True,
        text=True,
        timeout=280,
    )
    assert run.returncode == 0, run.stderr
    assert int(run.stdout) < PEAK_BYTES
