"""Pictures by Mitsuba, where it is installed, against those of the project's own."""

import sys

import numpy as np
import pytest

from service.inference.state import Poses
from service.simulate.path_tracing import PathTracer, PathTracingMissingError
from service.simulate.render import Light, Renderer
from tests.unit.simulate.test_materials import ball

SIZE = (64, 48)
POSE = Poses(np.array([[0.8, 0.1, -0.5, 0.3]]), np.array([[30.3, 22.1]]), np.log([11.0]), np.zeros((1, 0)))


def both(mesh, articulation, light, materials, pose=POSE):
    pytest.importorskip("mitsuba", reason="the path tracer is not installed")
    made = (kind(mesh, articulation, np.random.default_rng(3), materials) for kind in (PathTracer, Renderer))
    return [one.render(pose, SIZE, light) for one in made]


def test_without_mitsuba_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    with pytest.raises(PathTracingMissingError, match="pip install mitsuba"):
        PathTracer(*ball(1), np.random.default_rng(0))


@pytest.mark.parametrize("roll", [0, 100, 230])
def test_a_chalk_ball_is_where_and_as_bright_as_it_should_be(roll):
    light = Light(phase_deg=50, sun_roll_deg=roll, ambient=0.0, specular=0.0)
    traced, own = both(*ball(), light, "painted")
    assert np.abs(traced.coverage - own.coverage).mean() < 0.01
    assert np.abs(traced.radiance - own.radiance).max() < 0.2 * own.radiance.max()
    assert traced.radiance.sum() == pytest.approx(own.radiance.sum(), rel=0.05)


def test_a_spacecraft_of_many_materials_has_the_same_outline(demo):
    _, mesh, articulation = demo
    light = Light(phase_deg=70, sun_roll_deg=20, ambient=0.0, earth=0.1, towards_earth=(0.3, -0.9, -0.2))
    joints = np.zeros((1, articulation.n_joints))
    pose = Poses(POSE.quaternion, POSE.position, np.log([20.0 / mesh.radius]), joints)
    traced, own = both(mesh, articulation, light, "mixed", pose)
    assert np.abs(traced.coverage - own.coverage).mean() < 0.01
    assert np.corrcoef(traced.radiance.ravel(), own.radiance.ravel())[0, 1] > 0.8
