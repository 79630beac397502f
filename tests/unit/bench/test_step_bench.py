"""The step's benchmark: rows of the contract, what is left out and why, and the two commands."""

import json
import subprocess
import sys

import numpy as np
import pytest
from typer.testing import CliRunner

from gpu.bench import Contestant
from gpu.device import find_devices
from gpu.errors import DeviceError
from gpu.scorer import ReferenceScorer
from service.bench.bodies import body_of
from service.bench.step_bench import StepContestant, StepPlan, bench_step, config_of, step_contestants
from service.bench.step_scene import step_scene
from service.cli import app

RUNNER = CliRunner()
WIDE = {"COLUMNS": "200", "TERM": "dumb"}
TINY = StepPlan(particles=(20, 40), size_px=48, repeats=2)
SCORERS = {"backend", "device", "faces", "size_px", "us_per_particle", "max_rel_error"}
STEP = {"backend", "particles", "size_px", "faces", "step_ms", "score_ms"}


class Slow:
    """A step that takes no time and says that the scorer took some."""

    device = "slow"

    def __init__(self, scorer, scene, particles, seed):
        self.frames = []

    def run(self, frame):
        self.frames.append(frame)
        return 1e-3


def broken(mesh):
    raise DeviceError("no such device")


def dying(scorer, scene, particles, seed):
    raise DeviceError("not on this one")


@pytest.fixture(scope="module")
def body():
    return body_of(1_000)


def test_what_cannot_run_or_would_take_too_long_is_told(body):
    right = Contestant("right", ReferenceScorer)
    entries = [
        StepContestant("slow", right, Slow),
        StepContestant("slow", Contestant("none", broken), Slow),
        StepContestant("dying", right, dying),
    ]
    figures = bench_step(entries, body, TINY)
    assert [(row.backend, row.step, row.particles) for row in figures.rows] == [
        ("right", "slow", 20),
        ("right", "slow", 40),
    ]
    assert figures.absent == {"none": "no such device", "right, dying": "not on this one"}
    hurried = bench_step(entries[:1], body, StepPlan(particles=(1, 10**12), size_px=48, repeats=1, longest_s=1e-3))
    assert [row.particles for row in hurried.rows] == [1]
    assert "would take about" in hurried.absent["right, slow"]


def test_every_step_runs_and_scoring_is_part_of_it(body):
    figures = bench_step(step_contestants(["outline"]), body, TINY)
    if "outline" in figures.absent:
        pytest.skip(figures.absent["outline"])
    assert len(figures.rows) == 6
    for row in figures.rows:
        assert 0 < row.score_ms <= row.step_ms
        assert 0 < row.score_share <= 1


def test_the_scene_is_one_that_the_prior_allows(body):
    scene = step_scene(body, 48, 0)
    state = scene.near_truth(np.random.default_rng(0), 50, config_of(50))
    assert scene.domain.contains(scene.truth).all()
    assert len(state.poses) == 50
    assert np.exp(state.log_weights).sum() == pytest.approx(1)
    assert (config_of(50).filter.method, config_of(50).filter.particles) == ("bootstrap", 50)


PEAKS = """
import numpy as np
from service.bench.peak_memory import peak_mib
print(peak_mib(lambda: None), peak_mib(lambda: np.ones(64 << 17)))  # 64 MiB
"""


def test_the_peak_is_above_what_is_allocated():
    # In a process of its own: what other tests left to free would be in these figures.
    ran = subprocess.run([sys.executable, "-c", PEAKS], capture_output=True, text=True, check=True)
    before, after = ran.stdout.split()
    if before == "None":
        pytest.skip("this system does not tell")
    assert float(after) > float(before) + 60


def test_the_scorers_command(tmp_path):
    pytest.importorskip("matplotlib")
    out = ["--json", str(tmp_path / "rows.json"), "--plot", str(tmp_path / "plot.png")]
    small = ["--quick", "--size", "32", "--faces", "1000", "--backend", "reference", "--backend", "opencv"]
    result = RUNNER.invoke(app, ["bench", "scorers", *small, *out], env=WIDE)
    assert result.exit_code == 0, result.output
    document = json.loads((tmp_path / "rows.json").read_text())
    assert [row["backend"] for row in document["rows"]] == ["reference", "opencv"]
    assert set(document["rows"][0]) >= SCORERS
    assert [row["us_per_particle"] for row in document["paper"]] == [11_700, 5_400, 1_200]
    assert "11,700" in result.output
    assert (tmp_path / "plot.png").read_bytes()[:4] == b"\x89PNG"


def test_the_step_command(tmp_path):
    pytest.importorskip("matplotlib")
    if all(report.rejected for report in find_devices()):
        pytest.skip("no OpenCL device answers")
    out = ["--json", str(tmp_path / "rows.json"), "--plot", str(tmp_path / "plot.png")]
    small = ["--quick", "--size", "32", "--faces", "1000", "--particles", "5", "--backend", "outline"]
    result = RUNNER.invoke(app, ["bench", "step", *small, *out], env=WIDE)
    assert result.exit_code == 0, result.output
    rows = json.loads((tmp_path / "rows.json").read_text())["rows"]
    assert {row["step"] for row in rows} >= {"paper, host"}
    assert set(rows[0]) >= STEP
    assert (tmp_path / "plot.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize("command", ["scorers", "step"])
def test_an_unknown_backend_is_refused_in_a_line(command):
    result = RUNNER.invoke(app, ["bench", command, "--backend", "abacus"], env=WIDE)
    assert result.exit_code == 1
    assert "abacus" in result.output
    assert "Traceback" not in result.output
