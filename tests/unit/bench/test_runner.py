"""Passes through the tracker: from a folder and from the simulator, the same answers."""

import json
from dataclasses import replace

import numpy as np
import pytest

from service.bench.folder import SequenceError, find_sequences, listed_symmetries
from service.bench.passes import random_case, simulated_case
from service.bench.runner import Entry, Terms, learned_sky, run_case
from service.cli.simulate import before_ground
from service.imaging.background import Background
from service.imaging.sky import derive
from service.sessions.config import effective
from service.simulate.folder import write_sequence
from service.simulate.scenario import PRESETS, randomised
from service.simulate.sequence import SimulatedPass


@pytest.fixture(scope="module")
def scenario():
    base = PRESETS["night"]()
    motion = replace(base.motion, frames=5, outage=(2, 1), extent=0.7)
    return replace(base, size=(64, 64), motion=motion, background_frames=4)


@pytest.fixture(scope="module")
def folder(satellite, scenario, tmp_path_factory):
    out = tmp_path_factory.mktemp("sequences") / "one"
    write_sequence(SimulatedPass(satellite.mesh, satellite.articulation, scenario), out, "demo.glb", satellite.data)
    return out


def entries(*names):
    return [Entry(name, effective({"filter": {"preset": "paper", "particles": 40}})) for name in names]


def test_a_folder_and_its_simulation_give_the_same_answers(tracker, shelf, satellite, scenario, folder):
    (sequence,) = find_sequences(folder.parent)
    from_disk = run_case(tracker, sequence.case(shelf), entries("paper"))[0]
    streamed = run_case(tracker, simulated_case("one", satellite, scenario, ("wing",)), entries("paper"))[0]
    assert [f.status for f in from_disk.frames] == [f.status for f in streamed.frames]
    assert [f.visible for f in from_disk.frames] == [True, True, False, True, True]
    for a, b in zip(from_disk.frames, streamed.frames, strict=True):
        for name in ("orientation_deg", "position_px", "scale_percent", "joint", "iou"):
            assert getattr(a, name) == pytest.approx(getattr(b, name), abs=2e-3, nan_ok=True)
    assert from_disk.facts["snr"] == pytest.approx(streamed.facts["snr"], rel=1e-3)
    assert from_disk.facts["snr"] > 3
    assert streamed.facts["d_over_r0"] == 0.0
    assert from_disk.facts["size_px"] == pytest.approx(0.7 * 64, rel=0.05)


def test_entries_do_not_disturb_each_other(tracker, satellite, scenario):
    case = simulated_case("one", satellite, scenario, ())
    heard = []
    one, other = run_case(tracker, case, entries("one", "other"), terms=Terms(limit=2), progress=heard.append)
    assert (one.entry, other.entry, heard, one.n_joints) == ("one", "other", [1, 2], 0)
    assert [f.orientation_deg for f in one.frames] == [f.orientation_deg for f in other.frames]


def test_a_pass_before_a_ground_is_told_the_box_of_its_body(tracker, shelf, satellite, scenario, tmp_path):
    motion = replace(scenario.motion, frames=2, outage=None)
    there = replace(before_ground(scenario, 2.0), motion=motion)
    simulated = SimulatedPass(satellite.mesh, satellite.articulation, there)
    write_sequence(simulated, tmp_path / "one", "demo.glb", satellite.data)
    case = find_sequences(tmp_path)[0].case(shelf)
    x, y, width, height = case.box
    covered = simulated.picture(0).coverage > 0.5
    assert covered.sum() == covered[int(y) : int(y + height), int(x) : int(x + width)].sum() > 0
    sky = derive(Background.from_bytes(learned_sky(tracker, case, effective({}), [])), "auto", 1.0)
    assert sky.clutter is not None and list(case.backgrounds()) == []


def test_random_passes_differ_by_their_seed(satellite):
    cases = [random_case("p", satellite, randomised(seed, size=(48, 48), frames=2), ()) for seed in (0, 0, 1)]
    poses = [next(case.frames())[1].quaternion for case in cases]
    assert np.array_equal(poses[0], poses[1])
    assert not np.allclose(poses[0], poses[2])


def test_a_folder_says_what_it_lacks(shelf, folder, tmp_path):
    with pytest.raises(SequenceError, match=r"no case\.json"):
        find_sequences(tmp_path)
    with pytest.raises(SequenceError, match="no sequence 'two'; there are one"):
        find_sequences(folder.parent, ["two"])
    case = json.loads((folder / "case.json").read_text())
    (tmp_path / "case.json").write_text(json.dumps({**case, "mesh": "meshes/gone.glb"}))
    with pytest.raises(SequenceError, match=r"no mesh meshes/gone\.glb"):
        find_sequences(tmp_path)[0].case(shelf)


def test_symmetries_are_read_beside_the_mesh(tmp_path):
    mesh = tmp_path / "a.glb"
    assert listed_symmetries(mesh) is None
    (tmp_path / "symmetry.json").write_text(json.dumps({"a.glb": [np.diag([1.0, -1.0, 1.0]).tolist()]}))
    (matrix,) = listed_symmetries(mesh)
    assert np.linalg.det(matrix) == -1
    assert listed_symmetries(tmp_path / "b.glb") is None
