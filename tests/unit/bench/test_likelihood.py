"""``skypose bench likelihood``: what is told, what the rows come to, and the command on one small pass."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from service.bench.folder import find_sequences
from service.bench.likelihood import LikelihoodPlan, LikelihoodRow, Looked, Views, off
from service.bench.likelihood_pictures import ROWS, contact_sheets
from service.bench.likelihood_report import MEANINGS, overall
from service.bench.told import Told, turned
from service.cli import app
from service.inference.articulation import hold
from service.simulate.folder import write_sequence
from service.simulate.mixed_passes import randomised_mixed
from service.simulate.sequence import SimulatedPass

RUNNER = CliRunner()
SUN = np.array([0.6, 0.0, -0.8])
ROW = LikelihoodRow("one", 0, False, True, 3.0, 2.0, 1.0, True, 0.5, True, True, 0.2, 900.0, 2000.0, 6.0, 300.0)


def test_the_prior_is_what_is_told(case_of, block):
    case = replace(case_of(block), towards_sun=SUN, scale_prior=(5.0, 0.03))
    prior = LikelihoodPlan().prior(case)
    np.testing.assert_allclose(prior.towards_sun, SUN)
    assert (prior.log_scale, prior.sun_sigma) == (None, pytest.approx(np.deg2rad(1.0)))
    wrong = LikelihoodPlan(Told(True, 5.0, True), sun_sigma_deg=5.0)
    np.testing.assert_allclose(wrong.prior(case).towards_sun, turned(SUN, 5.0))
    assert wrong.prior(case).sun_sigma == pytest.approx(np.deg2rad(5.0))
    assert (wrong.prior(case).log_scale, wrong.prior(case).log_scale_sigma) == (pytest.approx(np.log(5.0)), 0.03)
    assert wrong.says == "told: the Sun 5° wrong (to 5°), the scale by its range"
    blind = LikelihoodPlan(Told(sun=False))
    assert (blind.prior(case).towards_sun, blind.prior(case).sun_sigma) == (None, 1.0)
    assert blind.says == "told: no Sun, no scale"
    assert LikelihoodPlan().prior(case_of(block)).towards_sun is None


def test_the_frames_are_those_within_the_limit():
    assert LikelihoodPlan(frames=(10, 0, 5)).wanted == [0, 5, 10]
    assert LikelihoodPlan(limit=6).wanted == [0, 5]


def test_the_start_is_always_as_far_off(satellite):
    held = hold(satellite.articulation, ("wing",), {})
    steps = [off(held, np.random.default_rng(seed))[0] for seed in range(3)]
    for step in steps:
        assert np.rad2deg(np.linalg.norm(step[:3])) == pytest.approx(2.0)
        assert np.linalg.norm(step[3:5]) == pytest.approx(1.0)
        np.testing.assert_allclose(np.abs(step[5:]), [np.log(1.01), 2.0])
    assert not np.allclose(steps[0][:3], steps[1][:3])


def test_shares_leave_out_what_is_not_defined():
    rows = [
        ROW,
        replace(ROW, margin_nats=None, twin_margin_nats=None, found_twin_ok=None, turbulent=True, in50=False),
        replace(ROW, truth_wins=False, margin_nats=-6.0, twin_margin_nats=-1.0, found_err_deg=80.0),
        replace(ROW, truth_wins=False, margin_nats=-4.0, found_twin_ok=False, in90=False),
    ]
    total = overall(rows)
    assert set(total) == set(MEANINGS)
    assert (total["n"], total["truth_wins"], total["lost_far"], total["worst_nats"]) == (4, 0.5, 0.25, -6.0)
    assert (total["beats_twin"], total["found"], total["right_twin"]) == (0.667, 0.75, 0.667)
    assert (total["in50_calm"], total["in90_calm"]) == (1.0, 0.667)
    assert (total["in50_turbulent"], total["in90_turbulent"]) == (0.0, 1.0)
    assert overall([ROW])["in50_turbulent"] is None
    assert overall([ROW, replace(ROW, found_err_deg=None)])["found"] == 0.5


def test_the_narrowest_frames_are_shown_first():
    frame = np.eye(16, dtype=np.float32)
    views = Views(frame, (frame, 0 * frame), (0 * frame, frame))
    wide = [Looked(replace(ROW, margin_nats=float(k)), views) for k in range(ROWS, 0, -1)]
    none = Looked(replace(ROW, margin_nats=None), replace(views, other=None))
    (first, data), (second, rest) = contact_sheets([none, *wide])
    assert (first, second) == ("frames_00.png", "frames_01.png")
    full, short = (cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR) for png in (data, rest))
    assert full.shape[0] > 8 * short.shape[0] and full.shape[1] == short.shape[1]


def test_the_command(block, tmp_path, monkeypatch):
    monkeypatch.setattr("service.inference.model.search.BANK_SIZE", 500)  # it need not find, only run
    scenario = replace(randomised_mixed(1, size=(96, 96), frames=2), background_frames=3)
    folder, out, report = tmp_path / "passes", tmp_path / "rows.json", tmp_path / "report"
    for name in ("one", "two"):
        (folder / name).mkdir(parents=True)
    write_sequence(SimulatedPass(block.mesh, block.articulation, scenario), folder / "one", "block.glb", block.data)
    (folder / "two" / "case.json").write_text("{}")
    arguments = ["--case", "one", "--frames", "0", "--range", "--json", str(out), "--report", str(report)]
    result = RUNNER.invoke(
        app, ["bench", "likelihood", str(folder), *arguments], env={"COLUMNS": "220"}, catch_exceptions=False
    )
    assert result.exit_code == 0, result.output
    document = json.loads(out.read_text())
    (row,) = document["rows"]
    assert set(row) == set(LikelihoodRow.__dataclass_fields__)
    assert (row["case"], row["frame"]) == ("one", 0)
    assert row["truth_wins"] == (row["margin_nats"] is None or row["margin_nats"] >= 0)
    assert row["refined_err_deg"] < 2.0  # a block of one material: a mirror twin or half a turn may look alike
    assert 0 < row["rough_nats"] < 5
    assert min(row["bank_ms"], row["search_ms"], row["evidence_ms"], row["draw_us"]) > 0
    assert document["told"] == "told: the Sun (to 1°), the scale by its range" and document["overall"]["n"] == 1
    assert "truth_wins" in result.output and document["absent"] == {}
    assert {path.name for path in report.iterdir()} == {"report.md", "rows.json", "frames_00.png"}
    assert "frames_00.png" in (report / "report.md").read_text()


@pytest.mark.parametrize("frames", ["x", "0,-1", ""])
def test_frames_that_are_no_numbers_are_refused(frames, tmp_path):
    result = RUNNER.invoke(app, ["bench", "likelihood", str(tmp_path), "--frames", frames])
    assert result.exit_code == 2 and "0,5,10" in result.output


def test_a_folder_without_a_sequence_is_refused_in_a_line(tmp_path):
    result = RUNNER.invoke(app, ["bench", "likelihood", str(tmp_path)])
    assert result.exit_code == 1 and "case.json" in result.output


@pytest.mark.parametrize(
    ("note", "facts"), [("calm, 9 px", {"d_over_r0": 0.0}), ("D/r0 5.6", {"d_over_r0": 5.6}), ("", {})]
)
def test_a_folders_note_tells_the_air(satellite, shelf, tmp_path, note, facts):
    (tmp_path / "demo.glb").write_bytes(satellite.data)
    described = {"name": "one", "mesh": "demo.glb", "width": 64, "height": 64, "note": note}
    (tmp_path / "case.json").write_text(json.dumps(described))
    (sequence,) = find_sequences(tmp_path)
    assert dict(sequence.case(shelf).facts) == facts
