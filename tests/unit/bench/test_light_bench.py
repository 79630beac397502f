"""``skypose bench light``."""

import json

from typer.testing import CliRunner

from service.cli import app

RUNNER = CliRunner()


def test_the_light_command(tmp_path):
    out = tmp_path / "light.json"
    sizes = ["--side", "24", "--supersample", "2", "--shadow", "48", "--quick"]
    result = RUNNER.invoke(app, ["bench", "light", *sizes, "--json", str(out)], env={"COLUMNS": "200"})
    assert result.exit_code == 0, result.output
    document = json.loads(out.read_text())
    rows = document["rows"]
    assert [(row["way"], row["shadow_px"]) for row in rows] == [
        ("planes", 48),
        ("combined", 48),
        ("combined", 0),
        ("templates", 128),
        ("evidence", 48),
    ]
    assert all(row["us_per_pose"] > 0 and row["mesh"] == "demo" for row in rows)
    assert rows[0]["agreement"] > 0.97
    assert "templates" in result.output and "cores" in result.output


def test_a_mesh_that_is_none_is_refused_in_a_line(tmp_path):
    (tmp_path / "x.obj").write_text("nothing")
    result = RUNNER.invoke(app, ["bench", "light", "--mesh", str(tmp_path / "x.obj")])
    assert result.exit_code == 2
