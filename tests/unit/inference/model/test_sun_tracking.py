"""Panels that face the Sun: as a brute search has them, their slopes, and what they are worth to a search."""

from dataclasses import replace

import numpy as np
import pytest
from lit_body import SUN, box, lit_body, lit_mesh
from lit_search import TOLD, half_turns, off_deg, sight_of, truth

from gpu.mesh import assemble
from service.errors import ConfigError
from service.inference.articulation import Articulation, Joint, Stage, part_transforms
from service.inference.model import search as searching
from service.inference.model.search import make_bank, search, searched_joints
from service.inference.model.stages import Body
from service.inference.params import JointParams
from service.inference.pose import exp_so3, retract
from service.inference.state import Poses
from service.sessions.config import check_joints, effective
from service.workers.panels import facing, sun_tracking

PANEL = JointParams(free="all", sun_tracking=("panel",), sun_tracking_sigma_deg=5.0)


def poses(n: int, joints: int, seed: int = 1) -> Poses:
    rng = np.random.default_rng(seed)
    turned = exp_so3(rng.normal(0, 2, (n, 3)))
    return Poses(turned, np.full((n, 2), 50.0), np.full(n, 2.0), rng.uniform(-170, 170, (n, joints)))


def suns(n: int, seed: int = 2) -> np.ndarray:
    drawn = np.random.default_rng(seed).normal(size=(n, 3))
    return drawn / np.linalg.norm(drawn, axis=1, keepdims=True)


def faced(articulation: Articulation, at: Poses, part: int, normal: np.ndarray, towards: np.ndarray) -> np.ndarray:
    moved = part_transforms(articulation, at)[:, part, :, :3] @ normal
    return np.abs(np.sum(moved / np.linalg.norm(moved, axis=1, keepdims=True) * towards, axis=1))


def two_axes(ratio: float = 1.0, limits: tuple[float, float] = (-180.0, 180.0)) -> tuple:
    """A truss that turns about x, and on it a panel that turns about y."""
    mesh = assemble([box("bus", (1, 1, 1), (0, 0, 0)), box("panel", (1.0, 3.0, 0.05), (0.0, 2.5, 0.0))])
    origin = tuple(-c for c in mesh.centre)
    truss = Joint("truss", "revolute", *limits, 0.0, (Stage("revolute", ("panel",), (1.0, 0, 0), origin, 0, ratio),))
    panel = Joint("panel", "revolute", -180.0, 180.0, 0.0, (Stage("revolute", ("panel",), (0, 1.0, 0), origin, 1),))
    return mesh, Articulation(("bus", "panel"), (panel, truss))


def test_a_panel_on_a_hinge_is_turned_as_far_as_it_helps():
    mesh, articulation = lit_mesh()
    told, at, towards = sun_tracking(mesh, articulation, PANEL), poses(20, 1), suns(20)
    assert np.abs(told.normals[0]) == pytest.approx([0, 0, 1])
    pointed = told.pointed(at, towards)
    best = faced(articulation, pointed, 2, told.normals[0], towards)
    for value in range(0, 360, 5):
        other = replace(at, joints=np.full((20, 1), float(value)))
        assert (faced(articulation, other, 2, told.normals[0], towards) <= best + 1e-6).all()
    assert told.off(pointed, towards) == pytest.approx(0.0, abs=1e-3)
    assert np.abs(told.off(at, towards)).max() <= 90.0
    assert np.abs(pointed.joints - at.joints).max() <= 90.0


@pytest.mark.parametrize("ratio", [1.0, -2.0])
def test_two_hinges_turn_it_to_the_sun_altogether(ratio):
    mesh, articulation = two_axes(ratio)
    told = sun_tracking(mesh, articulation, JointParams("all", {}, ("panel", "truss")))
    assert told.columns == (1, 0)  # the truss first, which carries the panel
    at, towards = poses(20, 2), suns(20)
    pointed = told.pointed(at, towards)
    assert (faced(articulation, pointed, 1, told.normals[0], towards) > np.cos(np.deg2rad(6.0))).mean() > 0.9


def test_a_hinge_stops_where_its_range_ends():
    mesh, articulation = two_axes(limits=(-20.0, 30.0))
    told = sun_tracking(mesh, articulation, JointParams("all", {}, ("truss",)))
    pointed = told.pointed(poses(30, 2), suns(30)).joints[:, 1]
    assert (pointed >= -20.001).all() and (pointed <= 30.001).all() and len(np.unique(pointed.round(2))) > 5


def test_slopes_are_differences_of_it():
    mesh, articulation = lit_mesh()
    told, at, towards = sun_tracking(mesh, articulation, PANEL), poses(1, 1, 4), suns(1)
    at = told.pointed(at, towards)
    off, slopes = told.slopes(at, towards[0])
    move = np.array([[0.02, -0.03, 0.01, 3.0, 2.0, 0.1, 1.5]])
    assert off == pytest.approx(0.0, abs=1e-3) and slopes[0, 6] == pytest.approx(-1 / 5.0, rel=1e-3)
    assert told.off(retract(at, move), towards)[0] / 5.0 == pytest.approx(slopes @ move[0], abs=0.05)
    assert told.log_density(retract(at, move), towards) == pytest.approx(-0.5 * (slopes @ move[0]) ** 2, abs=0.05)


def test_a_search_asks_for_fewer_templates_and_finds_the_panel(monkeypatch):
    monkeypatch.setattr(searching, "BANK_SIZE", 1500)
    mesh, articulation = lit_mesh()
    told = replace(TOLD, tracking=sun_tracking(mesh, articulation, PANEL))
    drawing = lit_body()
    body = Body(drawing, drawing, drawing)
    assert searched_joints(drawing, told) == [] and searched_joints(drawing, TOLD) == [0]
    bank = make_bank(body, told)
    assert len(bank.poses) == 1500
    at = told.tracking.pointed(truth(4, True), SUN[None])
    found = search(body, sight_of(at), bank, told).basins[0]
    assert off_deg(found.pose, at) < 2.0
    assert half_turns(found.pose, at) < 3.0


def test_most_of_a_panel_faces_its_normal():
    mesh, _ = lit_mesh()
    assert abs(facing(mesh, 2)[2]) > 0.999


@pytest.mark.parametrize(
    ("joints", "said"),
    [
        ({"sun_tracking": ["panel"]}, "no free joint"),
        ({"free": ["panel"], "sun_tracking": ["wing"]}, "no free joint"),
        ({"free": ["slide"], "sun_tracking": ["slide"]}, "slides"),
    ],
)
def test_what_cannot_track_the_sun_is_refused(joints, said):
    _, articulation = lit_mesh()
    slide = Joint("slide", "prismatic", 0.0, 1.0, 0.0, (Stage("prismatic", ("boom",), (0, 0, 1.0)),))
    whole = replace(articulation, joints=(*articulation.joints, slide))
    with pytest.raises(ConfigError, match=said):
        check_joints(effective({"joints": joints}), whole)
    check_joints(effective({"joints": {"free": "all", "sun_tracking": ["panel"]}}), whole)
