"""``skypose bench track`` and ``bench ablate``: rows, report, and refusals with their reason."""

import json
import sys

import pytest
from typer.testing import CliRunner

from service.bench.ablation import VARIANTS, altered
from service.bench.report import CASE_COLUMNS
from service.cli import app
from service.cli.bench_run import entries_of, read_settings, variant_entries
from service.inference.model import prior

RUNNER = CliRunner()
WIDE = {"COLUMNS": "200", "TERM": "dumb"}
SMALL = ["--frames", "2", "--size", "64x64", "--set", "filter.particles=30"]
CONTRACT = ("preset", "case", "err1", "err5", "err10", "err_med", "err_p95", "within5", "modes5", "pos_med")
CONTRACT += ("scale_med", "joint_med", "iou_med", "ms_med")


def test_passes_become_rows_and_a_report(tmp_path):
    pytest.importorskip("matplotlib")
    out = ["--json", str(tmp_path / "rows.json"), "--report", str(tmp_path / "report")]
    result = RUNNER.invoke(app, ["bench", "track", "--passes", "2", "--preset", "paper", *SMALL, *out], env=WIDE)
    assert result.exit_code == 0, result.output
    document = json.loads((tmp_path / "rows.json").read_text())
    assert [row["case"] for row in document["rows"]] == ["pass_000", "pass_001"]
    assert set(CONTRACT) <= set(document["rows"][0])
    assert {"cpu", "cores", "scorer"} <= set(document["machine"])
    assert document["overall"][0]["cases"] == 2
    page = (tmp_path / "report" / "report.md").read_text()
    for plot in ("error_over_time", "success", "coverage", "time_per_frame"):
        assert f"({plot}.png)" in page
        assert (tmp_path / "report" / f"{plot}.png").read_bytes()[:4] == b"\x89PNG"
    assert len((tmp_path / "report" / "frames.csv").read_text().splitlines()) == 5
    assert "pass_001" in result.output


def test_mixed_passes_take_the_evaluators_options(tmp_path):
    few = ["--limit", "2", "--preset", "paper", *SMALL[2:], "--json", str(tmp_path / "rows.json")]
    told = ["--materials", "mixed", "--from", "1", "--sun-off", "5", "--range"]
    result = RUNNER.invoke(app, ["bench", "track", "--passes", "1", *few, *told], env=WIDE)
    assert result.exit_code == 0, result.output
    document = json.loads((tmp_path / "rows.json").read_text())
    assert document["rows"][0]["frames"] == 2
    assert {"right_twin", "silent"} <= set(document["rows"][0])
    assert {"acquired1", "right_twin", "silent", "hard90"} <= set(document["overall"][0])


def test_variants_stand_beside_the_default(tmp_path):
    simulated = RUNNER.invoke(
        app, ["simulate", "--out", str(tmp_path / "one"), "--frames", "2", "--size", "64x64", "--preset", "night"]
    )
    assert simulated.exit_code == 0
    arguments = ["bench", "ablate", str(tmp_path / "one"), "--variant", "paper", *SMALL[4:]]
    result = RUNNER.invoke(app, [*arguments, "--json", str(tmp_path / "rows.json")], env=WIDE)
    assert result.exit_code == 0, result.output
    document = json.loads((tmp_path / "rows.json").read_text())
    assert [(row["preset"], row["says"]) for row in document["overall"]] == [
        ("default", "nothing left out"),
        ("paper", "the published method"),
    ]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["track"], "give a folder of sequences, or --passes"),
        (["track", "nowhere"], "holds no sequence"),
        (["track", "nowhere", "--passes", "1", "--untied", "9"], "a folder and --untied cannot be told with --passes"),
        (["track", "--passes", "1", "--preset", "best"], "preset"),
        (["track", "--passes", "1", "--set", "filter.speed=3"], "speed"),
        (["track", "--passes", "1", "--set", "particles"], "SECTION.NAME=VALUE"),
        (["ablate", "--passes", "1", "--variant", "luck"], "no variant 'luck'"),
    ],
)
def test_refusals_say_why(arguments, message):
    result = RUNNER.invoke(app, ["bench", *arguments], env=WIDE)
    assert result.exit_code != 0
    assert message in result.output


def test_a_report_without_matplotlib_is_refused_before_the_work(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    result = RUNNER.invoke(app, ["bench", "track", "--passes", "1", "--report", str(tmp_path)], env=WIDE)
    assert result.exit_code == 1
    assert "pip install matplotlib" in result.output


def test_settings_reach_every_session_and_variants_win():
    assert read_settings(["filter.seed=3", "likelihood.feature=gradient"]) == {
        "filter": {"seed": 3},
        "likelihood": {"feature": "gradient"},
    }
    for entry in entries_of(["balanced", "paper"], ["filter.seed=3"]):
        assert (entry.config.filter.preset, entry.config.filter.seed) == (entry.name, 3)
    found = {entry.name: entry for entry in variant_entries((), ["camera.psf_sigma_px=2"])}
    assert list(found) == [variant.name for variant in VARIANTS]
    assert [found[name].config.camera.psf_sigma_px for name in ("default", "psf")] == [2.0, 0.3]
    assert found["paper"].config.filter.particles == 3000
    assert not found["twins"].twins
    changed = [
        one for one in found.values() if (one.config, one.twins, one.priors) != (found["default"].config, True, {})
    ]
    assert len(changed) == len(VARIANTS) - 1


def test_a_variants_priors_hold_while_its_frames_are_tracked():
    before = {name: getattr(prior, name) for variant in VARIANTS for name in variant.priors}
    for variant in VARIANTS:
        with pytest.raises(ZeroDivisionError), altered(variant.priors):
            assert {name: getattr(prior, name) for name in variant.priors} == variant.priors
            raise ZeroDivisionError
    assert {name: getattr(prior, name) for name in before} == before


def test_every_variant_and_column_is_documented(root):
    text = (root / "docs" / "benchmarks.md").read_text()
    for name in [*(variant.name for variant in VARIANTS[1:]), *CASE_COLUMNS[2:]]:
        assert f"`{name}`" in text


def motion(tmp_path, kind: str) -> dict:
    few = ["bench", "motion", "--frames", "8", "--span", "10", "--slowest", "2", "--json", str(tmp_path / "rows.json")]
    result = RUNNER.invoke(app, [*few, kind, "1"], env=WIDE)
    assert result.exit_code == 0, result.output
    return json.loads((tmp_path / "rows.json").read_text())


def test_motions_become_rows_and_a_line_for_each_law(tmp_path):
    document = motion(tmp_path, "--passes")
    assert [row["law"] for row in document["rows"]] == ["constant_rate", "tumbling"]
    assert {"law_right", "rate_met", "cover90", "ratios_within10"} <= set(document["overall"][0])


@pytest.mark.long
def test_modes_and_stations_become_rows(tmp_path):
    document = motion(tmp_path, "--modes")
    assert document["rows"][0]["truth"] == "inertially_fixed"
    assert {"right", "sure_right"} <= set(document["overall"][-1])
    document = motion(tmp_path, "--stations")
    assert document["overall"]["passes"] == 1
    assert set(document["rows"][0]["error_deg"]) == {"first", "second", "both"}
