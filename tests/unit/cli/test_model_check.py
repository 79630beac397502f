"""`skypose model check`: what is in a mesh, and what in it will hurt."""

import json

import cv2
import trimesh
from typer.testing import CliRunner

from gpu.mesh import load_mesh
from service.cli import app
from service.inference.articulation import Articulation
from service.models.check import examine
from service.models.symmetry import ModelSymmetries

RUNNER = CliRunner()


def examined(scene: trimesh.Scene | trimesh.Trimesh, unit_m: float | None = None) -> tuple[str, ...]:
    mesh = load_mesh(trimesh.Scene(scene).export(file_type="glb"), "glb")
    still = Articulation(tuple(part.name for part in mesh.parts))
    return examine(mesh, still, ModelSymmetries((), ()), unit_m).findings


def bus(**more: trimesh.Trimesh) -> trimesh.Scene:
    boxes = {"a": (2, 1, 1), "b": (0.8, 2.4, 0.8), "c": (0.8, 0.7, 2.9)}
    parts = {name: trimesh.creation.box(extents) for name, extents in boxes.items()} | more
    return trimesh.Scene(parts)


def test_a_usual_body_has_nothing_to_tell():
    assert examined(bus(), 1.0) == ()


def test_a_wrong_unit_is_told():
    assert "large" in examined(bus(), 1e-3)[0]


def test_a_panel_that_no_joint_moves_is_told():
    wing = trimesh.creation.box((4, 0.02, 1.5), trimesh.transformations.translation_matrix((3, 0, 0)))
    (told,) = examined(bus(wing=wing))
    assert "wing" in told and "joint" in told


def test_what_lies_far_away_is_told():
    speck = trimesh.creation.box((0.01, 0.01, 0.01), trimesh.transformations.translation_matrix((40, 0, 0)))
    assert "times as far out" in examined(bus(speck=speck))[0]


def test_the_command_prints_and_draws(tmp_path):
    picture = tmp_path / "demo.png"
    result = RUNNER.invoke(app, ["model", "check", "demo", "--unit-m", "1", "--out", str(picture), "--json"])
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert (told["joints"], told["findings"]) == (["wing"], [])
    assert abs(sum(told["surfaces"]) - 1) < 1e-3
    image = cv2.imread(str(picture))
    assert image.shape[1] == 3 * image.shape[0]
    assert (image.max(axis=(0, 2)) > 60).mean() > 0.3  # every view shows something
    plain = RUNNER.invoke(app, ["model", "check", "demo"])
    assert "joint wing: revolute" in plain.output and "nothing in it should hurt" in plain.output
