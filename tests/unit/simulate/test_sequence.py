"""Whole passes: repeatable, true to their truth, in the shape that the benchmark reads."""

import csv
import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from service.inference.pose import angle_between
from service.simulate.camera import Camera, Sensor
from service.simulate.folder import write_sequence
from service.simulate.motion import Motion, plan_track
from service.simulate.scenario import PRESETS, Scenario, randomised
from service.simulate.sequence import SimulatedPass


def short(scenario: Scenario, frames: int = 3) -> Scenario:
    return replace(scenario, background_frames=2, motion=replace(scenario.motion, frames=frames))


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_a_pass_is_the_same_every_time_and_another_seed_is_another_pass(demo, preset):
    _, mesh, articulation = demo
    scenario = short(PRESETS[preset]())
    first = SimulatedPass(mesh, articulation, scenario)
    images = [*first.backgrounds(), *first.frames()]
    again = SimulatedPass(mesh, articulation, scenario)
    for a, b in zip(images, [*again.backgrounds(), *again.frames()], strict=True):
        np.testing.assert_array_equal(a, b)
    for a, b in zip(images[2:], first.frames(), strict=True):
        np.testing.assert_array_equal(a, b)
    other = next(SimulatedPass(mesh, articulation, replace(scenario, seed=1)).frames())
    assert other.shape == images[2].shape == ((*scenario.size[::-1], 3) if preset == "day" else scenario.size[::-1])
    assert (other != images[2]).any()


def test_tumbling_is_at_the_stated_rate_about_the_stated_body_axis(demo):
    _, mesh, articulation = demo
    motion = Motion(frames=20, rate_deg_s=9.0, rate_axis=(0, 3, 4), wobble_px=0.0)
    track = plan_track(motion, articulation, mesh.radius, (256, 256), np.random.default_rng(0))
    q = track.poses.quaternion
    np.testing.assert_allclose(np.rad2deg(angle_between(q[1:], q[:-1])), 0.9, rtol=1e-9)
    np.testing.assert_allclose(track.poses.position, np.tile([0.53 * 256, 0.48 * 256], (20, 1)))
    assert 2 * mesh.radius * np.exp(track.poses.log_scale[0]) == pytest.approx(0.65 * 256)


def test_the_wobble_has_its_stated_size_and_memory(demo):
    _, mesh, articulation = demo
    motion = Motion(frames=4000, wobble_px=2.0, wobble_time_s=0.4)
    track = plan_track(motion, articulation, mesh.radius, (256, 256), np.random.default_rng(0))
    moved = track.poses.position - track.poses.position.mean(axis=0)
    assert moved.std() == pytest.approx(2.0, rel=0.1)
    memory = (moved[1:] * moved[:-1]).mean() / (moved**2).mean()
    assert memory == pytest.approx(np.exp(-0.1 / 0.4), abs=0.05)


def test_joints_turn_round_or_turn_back(demo):
    _, mesh, articulation = demo
    motion = Motion(frames=80, joint_rate_deg_s=100.0)
    (joint,) = articulation.joints
    for limits in ((-180.0, 180.0), (-30.0, 20.0)):
        limited = replace(joint, minimum=limits[0], maximum=limits[1])
        body = replace(articulation, joints=(limited,))
        track = plan_track(motion, body, mesh.radius, (256, 256), np.random.default_rng(0))
        values = track.poses.joints[:, 0]
        assert limits[0] <= values.min() < values.max() <= limits[1]
        steps = np.abs((np.diff(values) + 180) % 360 - 180)
        assert np.median(steps) == pytest.approx(10.0)


def test_signal_and_noise_are_those_of_the_sensor():
    camera = Camera(bits=16, signal_e=0.0, sky_e=(900.0,) * 3, read_noise_e=40.0, electrons_per_count=2.0)
    nothing = np.zeros((200, 200), dtype=np.float32)
    sensor = Sensor(camera, (200, 200), np.random.default_rng(0))
    image = sensor.read(nothing, nothing, nothing, np.random.default_rng(1)).astype(float)
    assert image.mean() == pytest.approx(12 + 450, abs=0.5)
    assert image.std() == pytest.approx(np.sqrt(900 + 40**2) / 2, rel=0.02)
    bright = Camera(bits=8, signal_e=1e6)
    white = np.ones((20, 20), dtype=np.float32)
    sensor = Sensor(bright, (20, 20), np.random.default_rng(0))
    assert (sensor.read(white, white, nothing[:20, :20], np.random.default_rng(1)) == 255).all()


def test_a_ground_drifts_behind_the_body_and_is_hidden_by_it():
    camera = Camera(bits=16, signal_e=4000.0, ground=0.5, ground_rate_px_s=(30.0, -20.0), read_noise_e=0.0)
    sensor = Sensor(camera, (60, 40), np.random.default_rng(0))
    first, second = sensor.ground_layer(0.0), sensor.ground_layer(0.1)
    assert first.shape == (40, 60) and 0 <= first.min() < first.max() <= 0.5
    assert np.array_equal(first[2:, :-3], second[:-2, 3:])
    nothing, half = np.zeros((40, 60), np.float32), np.zeros((40, 60), np.float32)
    half[:, :30] = 1.0
    image = sensor.read(nothing, half, nothing, np.random.default_rng(1), first).astype(float)
    dark = camera.bias_counts + camera.sky_e[1] / camera.electrons_per_count
    assert image[:, :30].mean() == pytest.approx(dark, abs=0.2)
    assert image[:, 30:].mean() == pytest.approx(dark + first[:, 30:].mean() * 1000, rel=0.01)
    assert Sensor(Camera(), (60, 40), np.random.default_rng(0)).ground_layer(0.0) is None


def test_the_folder_has_the_shape_of_the_benchmarks(demo, tmp_path):
    data, mesh, articulation = demo
    scenario = short(replace(PRESETS["outage"](), size=(96, 80)), frames=4)
    scenario = replace(scenario, motion=replace(scenario.motion, outage=(2, 1)))
    heard = []
    simulated = SimulatedPass(mesh, articulation, scenario)
    write_sequence(simulated, tmp_path / "a", "demo.glb", data, lambda *state: heard.append(state))
    assert heard[-1] == (6, 6)
    case = json.loads((tmp_path / "a" / "case.json").read_text())
    assert case["name"] == "a"
    assert (case["width"], case["height"], case["frames"], case["bits"], case["channels"]) == (96, 80, 4, 8, 1)
    (joint,) = case["joints"]
    np.testing.assert_allclose(joint.pop("origin"), [0.25, 0.8, 0.35], atol=1e-6)
    assert joint.pop("axis") == [0, 1, 0]
    assert joint == {"name": "wing", "nodes": ["wing"], "kind": "revolute", "min": -180, "max": 180}
    with (tmp_path / "a" / "truth.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["visible"] for row in rows] == ["1", "1", "0", "1"]
    fields = ["frame", "time_s", "qx", "qy", "qz", "qw", "x_px", "y_px", "scale_px", "visible", "wing"]
    assert list(rows[0]) == fields
    stored = cv2.imread(str(tmp_path / "a" / "frames" / "001.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(stored, list(simulated.frames())[1])
    assert len(list((tmp_path / "a" / "background").glob("*.png"))) == 2


def test_random_passes_differ_and_repeat():
    drawn = [randomised(seed) for seed in range(20)]
    assert drawn == [randomised(seed) for seed in range(20)]
    assert len({s.motion.extent for s in drawn}) == 20
    assert {s.camera.bits for s in drawn} == {8, 16}
    assert {s.air.d_over_r0 > 0 for s in drawn} == {True, False}
