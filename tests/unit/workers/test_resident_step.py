"""The paper's update on the device, for a session: replayed bit for bit, the host's law, and the host when it fails."""

from dataclasses import replace

import numpy as np
import pytest
from demo_jobs import FRAMES

import service.workers.resident
from gpu.errors import ScorerError
from gpu.scorer import open_scorer
from gpu.step import DeviceStep
from service.inference.articulation import Articulation
from service.inference.domain import Domain
from service.inference.params import FilterParams, PriorParams, SessionConfig
from service.inference.state import FilterState
from service.workers.codec import decode, encode
from service.workers.resident import ResidentSteps
from service.workers.scoring import TimedScorer
from service.workers.tracker import Tracker
from service.workers.visible import HalfShown

DEVICE = {"step": "device", "particles": 300, "resampler": "multinomial"}


def bits(report):
    poses = report.state.poses
    return b"".join(a.tobytes() for a in (poses.quaternion, poses.position, poses.joints, report.state.log_weights))


def test_a_replay_gives_the_same_bits_in_another_worker_and_after_a_checkpoint(demo, tracker):
    first, names = demo.track(tracker, "auto", **DEVICE)
    assert sum(name.endswith("(step on the device)") for name in names) == 1
    other = Tracker()
    state = None
    for index in range(FRAMES):
        stored = None if state is None else decode(FilterState, encode(state))
        report = other.track(demo.job("outline", index, stored, **DEVICE))
        state = report.state
    other.close()
    assert bits(report) == bits(first)
    assert report.estimate.log_evidence == first.estimate.log_evidence


def test_any_scorer_can_be_stepped_beside(demo, tracker):
    """A filled silhouette has the same sums as an outline, so the device's draws give the same bits."""
    expected, _ = demo.track(tracker, "outline", **DEVICE)
    report, _ = demo.track(tracker, "cpu", **DEVICE)
    assert np.allclose(report.state.poses.position, expected.state.poses.position)
    assert report.scorer.startswith("opencl:fill:")


def test_particles_stay_within_the_bounds_and_sum_to_one(demo, tracker):
    report, _ = demo.track(tracker, "auto", **DEVICE)
    assert np.exp(report.state.log_weights).sum() == pytest.approx(1)
    assert np.allclose(np.linalg.norm(report.state.poses.quaternion, axis=1), 1, atol=1e-12)
    mesh = tracker._mesh(*demo.model_of())
    with tracker._scorers.lend("the same", "reference", mesh, 1) as scorer:
        timed = TimedScorer(scorer, demo.report.articulation, np.zeros((64, 64), np.float32))
        assert HalfShown(timed, mesh, (64, 64))(report.state.poses).all()
    assert report.timing_ms["score"] <= report.timing_ms["step"]


def test_the_host_makes_the_step_that_the_device_fails(demo, tracker, monkeypatch):
    expected, _ = demo.track(tracker, "auto", **DEVICE | {"step": "host"})

    def failing(*_arguments):
        raise ScorerError("too little memory")

    monkeypatch.setattr(DeviceStep, "resample", failing)
    with pytest.warns(RuntimeWarning, match="too little memory; this step is made on the host"):
        report, names = demo.track(tracker, "auto", **DEVICE)
    assert bits(report) == bits(expected)
    assert not any("step on the device" in name for name in names)


def test_the_default_is_the_device_where_it_pays(demo, tracker, monkeypatch):
    mesh = tracker._mesh(*demo.model_of())
    scorer, steps = open_scorer(mesh), ResidentSteps(1)
    domain = Domain(64, 64, 1.0, Articulation(tuple(part.name for part in mesh.parts)), PriorParams())
    paper = SessionConfig(FilterParams(method="bootstrap", particles=5_000))

    def chosen(**changes):
        return steps.of(scorer, replace(paper, filter=replace(paper.filter, **changes)), domain) is not None

    assert not chosen()  # a CPU's device
    monkeypatch.setattr(service.workers.resident, "on_gpu", lambda _: True)
    assert chosen()
    assert not chosen(particles=4_999)
    assert not chosen(step="host")
    assert not chosen(resampler="residual")
    assert not chosen(method="mixture")
    assert chosen(particles=10, step="device")


@pytest.mark.parametrize("choices", [{"method": "mixture"}, {"method": "bootstrap", "resampler": "residual"}])
def test_what_the_device_cannot_step_is_refused(choices):
    with pytest.raises(ValueError, match="step device"):
        FilterParams(step="device", **choices)
