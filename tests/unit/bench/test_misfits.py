"""``skypose bench misfits``: frames that no model must explain are made as said, and answers to them counted."""

import json
from dataclasses import replace
from itertools import islice

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from service.bench.misfit_report import misfit_document
from service.bench.misfits import MisfitRow, clouded, crossed, mirrored, trailed, wrong_meshes
from service.bench.passes import simulated_case
from service.cli import app
from service.simulate.folder import write_sequence
from service.simulate.scenario import PRESETS
from service.simulate.sequence import SimulatedPass


@pytest.fixture(scope="module")
def scenario():
    base = PRESETS["night"]()
    motion = replace(base.motion, frames=4, outage=None, extent=0.5)
    return replace(base, size=(64, 64), motion=motion, background_frames=3)


@pytest.fixture(scope="module")
def case(satellite, scenario):
    return simulated_case("one", satellite, scenario, ())


def light_of(case):
    frames = [cv2.imdecode(np.frombuffer(body, np.uint8), cv2.IMREAD_UNCHANGED) for body, _ in case.frames()]
    return [image.astype(float) - float(np.median(image)) for image in frames]


def test_mirrored_frames_show_the_body_where_it_was_with_left_and_right_changed(case):
    before, after = light_of(case), light_of(mirrored(case, 2).case)
    assert np.array_equal(before[1], after[1])
    truth = next(islice(case.frames(), 2, None))[1]
    middle = round(2 * float(truth.position[0]))
    columns = np.arange(max(0, middle - 64), min(64, middle))
    assert np.array_equal(after[2][:, columns], before[2][:, middle - 1 - columns])
    assert not np.array_equal(before[2], after[2])


def test_a_cloud_takes_the_light_of_the_brighter_half(case):
    before, after = light_of(case), light_of(clouded(case, 2).case)
    assert np.array_equal(before[1], after[1])
    x = next(islice(case.frames(), 2, None))[1].position[0]
    halves = [np.arange(64) < x - 3, np.arange(64) > x + 3]
    bright = max(halves, key=lambda half: before[2][:, half].sum())
    other = halves[0] if bright is halves[1] else halves[1]
    assert after[2][:, bright].sum() < 0.25 * before[2][:, bright].sum()
    assert after[2][:, other].sum() == pytest.approx(before[2][:, other].sum(), rel=0.1)


def test_a_bird_hides_the_body_and_a_trail_runs_through_it(case):
    before, dark, bright = light_of(case), light_of(crossed(case, 2).case), light_of(trailed(case, 2).case)
    assert np.array_equal(before[1], dark[1]) and np.array_equal(before[1], bright[1])
    truth = next(islice(case.frames(), 2, None))[1]
    assert dark[2].sum() < 0.6 * before[2].sum()
    column, row = (truth.position + np.array([0.6, -0.8]) * 3.0).astype(int)  # on the trail, nearest to the body
    assert bright[2][row, column] > before[2][row, column] + 0.4 * 255
    assert np.abs(bright[2] - before[2])[:5, -5:].max() < 2  # far from it all is as it was


def test_after_so_many_frames_a_pass_goes_on_as_it_was(case):
    before, after = light_of(case), light_of(mirrored(case, 1, 2).case)
    assert [bool(np.array_equal(a, b)) for a, b in zip(before, after, strict=True)] == [True, False, False, True]


def test_every_body_is_followed_with_every_other_mesh(case):
    others = [replace(case, name=name, model=replace(case.model, key=key)) for name, key in ("ax", "by", "cy", "dz")]
    found = list(wrong_meshes(others, 3))
    assert [(one.case.name, one.case.model.key) for one in found] == [
        ("a", "y"), ("a", "z"), ("b", "x"), ("b", "z"), ("d", "x"), ("d", "y")
    ]  # fmt: skip
    assert len(list(wrong_meshes(others, 2))) == 2


def test_what_is_noticed_in_time_and_what_ends_wrongly_are_counted():
    rows = [
        MisfitRow("mesh", "a", "m", 0, 1, 0.0, "no_fit", ("no_fit",)),
        MisfitRow("mesh", "b", "m", 0, 6, 0.8, "tracking", ("tracking",)),
        MisfitRow("cloud", "b", "m", 2, None, 0.0, "acquiring", ("acquiring",)),
    ]
    overall = misfit_document({}, rows)["overall"]
    assert overall["mesh"] == {"passes": 2, "noticed": 0.5, "tracking_at_end": 0.5, "tracking": 0.4, "wrong": None,
                               "back_at_once": None}  # fmt: skip
    assert (overall["cloud"]["noticed"], overall["cloud"]["tracking_at_end"]) == (0.0, 0.0)
    assert "mirror" not in overall


def test_what_is_tracked_under_a_cloud_is_counted_where_it_is_wrong():
    rows = [
        MisfitRow("cloud", "b", "m", 2, None, 0.0, "acquiring", ("acquiring",), 0.0),
        MisfitRow("cloud", "c", "m", 2, 1, 0.5, "tracking", ("no_fit", "tracking"), 0.5),
    ]
    assert misfit_document({}, rows)["overall"]["cloud"]["wrong"] == 0.25


def test_how_many_are_back_at_once_is_counted_where_frames_follow():
    rows = [
        MisfitRow("mirror", "a", "m", 5, 1, 0.0, "lost", ("lost",), count=2, back_after=1),
        MisfitRow("mirror", "b", "m", 5, 1, 0.0, "lost", ("lost",), count=2, back_after=4),
        MisfitRow("mirror", "c", "m", 5, 1, 0.0, "lost", ("lost",), count=2),
        MisfitRow("mirror", "d", "m", 5, 1, 0.0, "lost", ("lost",)),
    ]
    assert misfit_document({}, rows)["overall"]["mirror"]["back_at_once"] == pytest.approx(1 / 3)


def test_the_command_follows_spoilt_passes(satellite, scenario, tmp_path):
    write_sequence(SimulatedPass(satellite.mesh, satellite.articulation, scenario), tmp_path / "one", "demo.glb",
                   satellite.data)  # fmt: skip
    out = tmp_path / "out.json"
    few = ["--set", "filter.preset=paper", "--set", "filter.particles=60"]
    done = CliRunner().invoke(app, ["bench", "misfits", str(tmp_path), "--kind", "mirror", "--json", str(out), *few])
    assert done.exit_code == 0, done.output
    (row,) = json.loads(out.read_text())["rows"]
    assert (row["kind"], row["from_frame"], len(row["statuses"])) == ("mirror", 2, 4)
    briefly = ["bench", "misfits", str(tmp_path), "--kind", "mirror", "--json", str(out), "--spoilt", "1", *few]
    assert CliRunner().invoke(app, briefly).exit_code == 0
    refused = CliRunner().invoke(app, ["bench", "misfits", str(tmp_path), "--kind", "fog"])
    assert refused.exit_code == 2
