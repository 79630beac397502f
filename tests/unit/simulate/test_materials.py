"""What bodies are made of, and that the light in ``case.json`` is the light in the pictures."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from gpu.mesh import Mesh, Part
from service.inference.articulation import Articulation
from service.inference.state import Poses
from service.simulate.folder import describe
from service.simulate.materials import PIECES_OF_THEIR_OWN, Surface, mixed, painted
from service.simulate.mixed_passes import randomised_mixed
from service.simulate.render import Light, Renderer
from service.simulate.scenario import PRESETS, randomised
from service.simulate.sequence import SimulatedPass

# Mean and standard deviation of the first frame at 96 x 80 px with the demo satellite, before there were materials.
BEFORE = {
    "night": (17.382, 11.585),
    "day": (74.490, 22.162),
    "seeing": (16.639, 6.090),
    "phase90": (357.427, 102.444),
    "panel": (365.205, 122.219),
    "small": (15.576, 4.704),
    "outage": (17.499, 11.651),
    "demo": (19.653, 19.340),
    "r0": (372.417, 120.444),
    "r1": (15.601, 2.970),
}


def ball(subdivisions=4):
    shape = trimesh.creation.icosphere(subdivisions=subdivisions)
    part = Part("a", np.asarray(shape.vertices), shape.faces.astype(np.int32))
    return Mesh((part,), (0, 0, 0), (2, 2, 2), 1.0, True), Articulation(("a",))


def many_boxes(parts=2, boxes=14):
    """Parts of separate boxes, each larger than the one before."""
    made = []
    for k in range(parts):
        shapes = [trimesh.creation.box([0.1 * (i + 1)] * 3).apply_translation((3 * i, 5 * k, 0)) for i in range(boxes)]
        whole = trimesh.util.concatenate(shapes)
        made.append(Part(f"p{k}", np.asarray(whole.vertices), whole.faces.astype(np.int32)))
    return Mesh(tuple(made), (0, 0, 0), (1, 1, 1), 50.0, True)


def pose(scale=24.0):
    return Poses(np.array([[1.0, 0, 0, 0]]), np.array([[32.0, 32.0]]), np.log([scale]), np.zeros((1, 0)))


@pytest.mark.parametrize("name", sorted(BEFORE))
def test_old_passes_are_what_they_were(demo, name):
    _, mesh, articulation = demo
    scenario = randomised(int(name[1:])) if name not in PRESETS else PRESETS[name]()
    scenario = replace(scenario, size=(96, 80), background_frames=1, motion=replace(scenario.motion, frames=1))
    (frame,) = SimulatedPass(mesh, articulation, scenario).frames()
    assert (frame.mean(), frame.std()) == (
        pytest.approx(BEFORE[name][0], abs=2e-3),
        pytest.approx(BEFORE[name][1], abs=2e-3),
    )


def test_painted_pieces_are_alike_all_over():
    mesh = many_boxes()
    surface = painted(mesh, np.random.default_rng(0))
    assert surface.roughness is None
    for piece in range(mesh.pieces.max() + 1):
        assert len(set(surface.diffuse[mesh.pieces == piece])) == 1
    assert 0.35 <= surface.diffuse.min() < surface.diffuse.max() <= 0.95


def test_the_largest_pieces_of_each_part_have_their_own_material_and_the_others_one_paint():
    mesh = many_boxes(parts=2, boxes=PIECES_OF_THEIR_OWN + 4)
    surface = mixed(mesh, np.random.default_rng(1))
    kinds = np.column_stack([surface.diffuse, surface.mirror, surface.roughness])
    assert len(np.unique(kinds, axis=0)) == 2 * PIECES_OF_THEIR_OWN + 1
    faces = 12  # of a box
    small = np.concatenate([np.flatnonzero(mesh.part_of == part)[: 4 * faces] for part in (0, 1)])
    assert len(np.unique(kinds[small], axis=0)) == 1
    assert 0.15 <= surface.diffuse[small[0]] <= 0.8


def test_materials_are_paint_panels_and_metal():
    drawn = [mixed(many_boxes(), np.random.default_rng(seed)) for seed in range(30)]
    diffuse, mirror = (
        np.concatenate([np.asarray(values) for values in column])
        for column in zip(*((surface.diffuse, surface.mirror) for surface in drawn), strict=True)
    )
    metal = mirror > 0.1
    assert 0.05 < metal.mean() < 0.3
    assert diffuse[metal].max() <= 0.08
    dark = ~metal & (diffuse <= 0.14)
    assert 0.05 < dark.mean() < 0.3
    assert diffuse[~metal & ~dark].min() >= 0.15 and diffuse[~metal].max() <= 0.8


def test_metal_shines_where_it_mirrors_the_sun_and_nowhere_else():
    mesh, articulation = ball()
    renderer = Renderer(mesh, articulation, np.random.default_rng(0), "mixed")
    n = mesh.n_faces
    renderer._surface = Surface(np.full(n, 0.05), np.full(n, 0.7), np.full(n, 0.25))
    light = Light(phase_deg=60.0, sun_roll_deg=0.0, ambient=0.0)
    radiance = renderer.render(pose(), (64, 64), light).radiance
    row, column = np.unravel_index(radiance.argmax(), radiance.shape)
    assert (column, row) == (pytest.approx(32 + 24 * 0.5, abs=2), pytest.approx(32, abs=2))  # half way: 30 degrees
    assert radiance.max() > 1.0
    assert np.median(radiance[radiance > 0]) < 0.15


def test_the_earth_lights_what_the_sun_does_not():
    mesh, articulation = ball()
    renderer = Renderer(mesh, articulation, np.random.default_rng(0), "mixed")
    night = Light(sun=0.0, ambient=0.0)
    assert renderer.render(pose(), (64, 64), night).radiance.max() == 0
    shone = renderer.render(pose(), (64, 64), replace(night, earth=0.1, towards_earth=(0.0, 1.0, 0.0))).radiance
    assert shone[48, 32] > 2 * shone[26, 32] > 0 == shone[12, 32]  # from below, and wide: it reaches past the middle
    sunlit = renderer.render(pose(), (64, 64), Light(ambient=0.0)).radiance
    assert 0.02 < shone.sum() / sunlit.sum() < 0.2


@pytest.mark.parametrize("make", [randomised, randomised_mixed])
def test_the_brightest_faces_face_the_sun_of_the_case_file(make):
    mesh, articulation = ball()
    for seed in range(6):
        scenario = make(seed, size=(64, 64), frames=1)
        light = replace(scenario.light, ambient=0.0, specular=0.0, earth=0.0)
        simulated = SimulatedPass(mesh, articulation, replace(scenario, light=light, materials="painted"))
        case = json.loads(json.dumps(describe(simulated, "a", "a.glb")))
        towards_sun = np.array(case["light"]["towards_sun"])
        centre, scale = simulated.track.poses.position[0], np.exp(simulated.track.poses.log_scale[0])
        radiance = simulated.picture(0).radiance
        rows, columns = np.nonzero(radiance > 0.3 * radiance.max())
        across = (np.column_stack([columns, rows]) + 0.5 - centre) / scale
        inside = np.linalg.norm(across, axis=1) < 0.95
        normals = np.column_stack([across, -np.sqrt(np.maximum(0.0, 1 - (across**2).sum(axis=1)))])[inside]
        found = np.linalg.lstsq(normals, radiance[rows, columns][inside], rcond=None)[0]
        apart = np.rad2deg(np.linalg.norm(found / np.linalg.norm(found) - towards_sun))
        assert apart < 2.0, (seed, scenario.light.phase_deg)


def test_the_told_scale_is_the_true_one_to_three_per_cent(demo):
    _, mesh, articulation = demo
    errors = []
    for seed in range(40):
        simulated = SimulatedPass(mesh, articulation, randomised_mixed(seed))
        case = describe(simulated, "a", "a.glb")
        assert case["scale_prior"]["relative_sigma"] == 0.03
        errors.append(np.log(case["scale_prior"]["px"]) - simulated.track.poses.log_scale[0])
    assert len(set(errors)) == 40
    assert np.std(errors) == pytest.approx(0.03, rel=0.35)
    assert abs(np.mean(errors)) < 0.015


def test_mixed_passes_differ_repeat_and_keep_to_their_ranges():
    drawn = [randomised_mixed(seed) for seed in range(200)]
    assert drawn[:5] == [randomised_mixed(seed) for seed in range(5)]
    assert {(s.size, s.motion.frames, s.materials, s.background_frames) for s in drawn} == {
        ((192, 192), 14, "mixed", 6)
    }
    spins = [s.motion.rate_deg_s * s.motion.frame_interval_s for s in drawn]
    assert 0.1 <= min(spins) < 0.15 and 1.5 < max(spins) <= 2.0
    phases = [s.light.phase_deg for s in drawn]
    assert min(phases) < 5 and 95 < max(phases) <= 110
    assert all(0.02 <= s.light.earth <= 0.12 for s in drawn)
    assert all(45 <= s.motion.extent * 192 <= 150 for s in drawn)
    assert 0 < sum(s.camera.colour for s in drawn) < 40
    assert {s.camera.bits for s in drawn} == {8, 16}
    assert 20 < sum(s.air.d_over_r0 > 0 for s in drawn) < 80
    assert max(s.air.d_over_r0 for s in drawn) <= 6.0
    assert {s.motion.joints for s in drawn} == {None, ()}


@pytest.mark.parametrize("first", [0, 7919, 100_000])
def test_neighbouring_seeds_cover_the_ranges_evenly(first):
    drawn = [randomised_mixed(first + k) for k in range(24)]
    signals = np.log([s.camera.signal_e / 500.0 for s in drawn]) / np.log(8.0)
    for shares in (signals, [(s.light.phase_deg / 110.0) ** (2 / 3) for s in drawn]):
        np.testing.assert_allclose(np.quantile(shares, [0.25, 0.5, 0.75]), [0.25, 0.5, 0.75], atol=0.1)
    assert 4 <= sum(s.air.d_over_r0 > 0 for s in drawn) <= 8
    assert 1 <= sum(s.camera.colour for s in drawn) <= 4
