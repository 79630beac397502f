"""What sessions are told of a pass, and what a folder says of it: Sun, range, ties, a sky without empty frames."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from service.bench.folder import find_sequences
from service.bench.passes import random_case
from service.bench.runner import Entry, Terms, run_case
from service.bench.told import Told, turned
from service.sessions.config import effective
from service.simulate.folder import write_sequence
from service.simulate.glb_writer import Hinge, SolidNode, write_glb
from service.simulate.mixed_passes import randomised_mixed
from service.simulate.primitives import box
from service.simulate.scenario import PRESETS
from service.simulate.sequence import SimulatedPass


def few_particles():
    return [Entry("paper", effective({"filter": {"preset": "paper", "particles": 40}}))]


@pytest.mark.parametrize("degrees", [0.0, 5.0, 15.0])
def test_a_wrong_sun_is_wrong_as_the_public_evaluator_makes_it(evaluator, degrees):
    sun = np.array([0.46, 0.08, -0.88])
    np.testing.assert_allclose(turned(sun, degrees), evaluator.turned(sun, degrees), atol=1e-12)


def test_a_folder_tells_the_sun_and_the_scale_that_the_simulator_wrote(satellite, shelf, tmp_path):
    scenario = replace(randomised_mixed(3, size=(48, 48), frames=1), background_frames=1)
    simulated = SimulatedPass(satellite.mesh, satellite.articulation, scenario)
    write_sequence(simulated, tmp_path / "one", "demo.glb", satellite.data)
    case = find_sequences(tmp_path)[0].case(shelf)
    np.testing.assert_allclose(case.towards_sun, scenario.light.direction(), atol=1e-6)
    assert case.scale_prior == (pytest.approx(simulated.told_scale, abs=1e-6), 0.03)
    streamed = random_case("one", satellite, scenario, ("wing",))
    np.testing.assert_array_equal(streamed.towards_sun, scenario.light.direction())
    assert streamed.scale_prior == (simulated.told_scale, 0.03)


def test_sessions_are_told_what_is_known_unless_they_were_told_otherwise(case_of, satellite):
    case = replace(case_of(satellite), towards_sun=np.array([0.6, 0.0, -0.8]), scale_prior=(5.0, 0.03))
    config = effective({})
    assert Told().configure(config, case).light.sun == pytest.approx((0.6, 0.0, -0.8))
    assert Told().configure(config, case).prior.scale_px is None
    assert Told(sun=False).configure(config, case) == config
    ranged = Told(sun=False, scale=True).configure(config, case).prior
    assert (ranged.scale_px, ranged.scale_sigma) == (5.0, 0.03)
    off = np.array(Told(sun_off_deg=15.0).configure(config, case).light.sun)
    assert np.rad2deg(np.arccos(off @ case.towards_sun)) == pytest.approx(15.0)
    unlike = replace(case, mesh_error=0.05)
    assert [Told(mesh_error=yes).configure(config, unlike).prior.mesh_error for yes in (True, False)] == [0.05, 0.0]
    said = effective({"light": {"sun": "unknown"}, "prior": {"scale_px": 4.0}})
    assert Told(scale=True).configure(said, case) == said


def test_every_frame_brings_what_its_session_was_told(case_of, satellite, monkeypatch, truth):
    jobs = []

    class Listener:
        def learn_background(self, job):
            return SimpleNamespace(background=b"sky")

        def track(self, job):
            jobs.append(job)
            raise InterruptedError

    frames = lambda: iter([(b"", replace(truth, visible=False))])  # noqa: E731
    case = replace(case_of(satellite), frames=frames, towards_sun=np.array([0.0, 0.6, -0.8]), scale_prior=(5.0, 0.1))
    with pytest.raises(InterruptedError):
        run_case(Listener(), case, few_particles(), Terms(told=Told(scale=True)))
    assert jobs[0].light.towards_sun == pytest.approx((0.0, 0.6, -0.8))
    low, high = jobs[0].scale_px
    assert low < 5.0 < high


def test_a_slow_camera_shows_one_frame_in_so_many_at_its_time(case_of, satellite, truth):
    every = [(bytes([k]), replace(truth, time_s=0.1 * k)) for k in range(10)]
    case = Told(every=4).shown(replace(case_of(satellite), frames=lambda: iter(every)))
    assert list(case.frames()) == [every[0], every[4], every[8]]


def test_a_pass_that_knows_nothing_tells_nothing(case_of, satellite):
    config = effective({})
    assert Told(scale=True).configure(config, case_of(satellite)) == config


def test_ties_of_the_file_are_uploaded_and_followers_are_not_estimated(shelf, tmp_path):
    data = write_glb(
        "pair",
        [
            SolidNode("bus", box((1.0, 1.2, 0.8))),
            SolidNode("left", box((2.0, 0.8, 0.1)), (-2.0, 0.0, 0.0), Hinge("alpha", "x")),
            SolidNode("right", box((2.0, 0.8, 0.1)), (2.0, 0.0, 0.0), Hinge("beta", "x")),
        ],
    )
    model = shelf.model("pair.glb", data)
    base = PRESETS["panel"]()
    motion = replace(base.motion, frames=2, joint_start_deg=30.0)
    scenario = replace(base, size=(64, 64), motion=motion, background_frames=1)
    write_sequence(SimulatedPass(model.mesh, model.articulation, scenario), tmp_path / "one", "pair.glb", data)
    file = tmp_path / "one" / "case.json"
    file.write_text(json.dumps({**json.loads(file.read_text()), "ties": {"beta": "alpha"}}))
    case = find_sequences(tmp_path)[0].case(shelf)
    assert case.free == ("alpha",)
    assert [joint.name for joint in case.model.articulation.joints] == ["alpha"]
    (_, truth), *_ = case.frames()
    assert truth.joints == {"alpha": 30.0}
    loose = find_sequences(tmp_path, untied_deg=10.0)[0].case(shelf)
    assert loose.free == ("alpha", "beta")
    rows = [truth.joints for _, truth in loose.frames()]
    for joint in loose.model.articulation.joints:
        values = [row[joint.name] for row in rows]
        assert (joint.minimum, joint.maximum) == (min(values) - 10.0, max(values) + 10.0)


def test_without_empty_frames_the_sky_is_learned_from_the_first_frames_border(tracker, satellite, shelf, tmp_path):
    scenario = replace(PRESETS["night"](), size=(64, 64), background_frames=0)
    scenario = replace(scenario, motion=replace(scenario.motion, frames=2, extent=0.5))
    write_sequence(
        SimulatedPass(satellite.mesh, satellite.articulation, scenario), tmp_path, "demo.glb", satellite.data
    )
    (tmp_path / "background").rmdir()
    (result,) = run_case(tracker, find_sequences(tmp_path)[0].case(shelf), few_particles())
    assert [frame.index for frame in result.frames] == [0, 1]
    assert "snr" not in result.facts
