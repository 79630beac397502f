"""A session's scorer by name: the same answers from each, who scored, and what a failing device does to a frame."""

from typing import get_args, get_type_hints

import numpy as np
import pyopencl as cl
import pytest
from demo_jobs import SIZE, DemoPass

import gpu.device
import gpu.scorer
from gpu.outline import OutlineScorer
from gpu.scorer import BACKENDS
from service.errors import BackendMissingError, ScorerFailedError, TooLargeError
from service.inference.params import FilterParams
from service.workers.scoring import REOPEN_S, Scorers
from service.workers.tracker import Tracker

PREFIX = {"outline": "opencl:outline:", "opengl": "opengl:", "cpu": "opencl:fill:1 of", "cpu-mt": "opencl:fill:"}


@pytest.fixture(scope="module")
def demo():
    return DemoPass()


@pytest.fixture
def device():
    usable = [report for report in gpu.device.find_devices() if report.rejected is None]
    if not usable:
        pytest.skip("no OpenCL device answers")
    return usable[0]


class Failing(OutlineScorer):
    """An outline scorer whose device fails for good in the second batch of the first frame."""

    calls = 0

    def _score(self, transforms, prefix):
        Failing.calls += 1
        if Failing.calls > 1:
            raise cl.RuntimeError("clEnqueueReadBuffer failed: DEVICE_NOT_AVAILABLE")
        return super()._score(transforms, prefix)


@pytest.fixture
def failing(monkeypatch, device):
    Failing.calls = 0
    monkeypatch.setattr(gpu.scorer, "OutlineScorer", Failing)
    monkeypatch.setattr("gpu.outline.batches", lambda device, n, each: (slice(k, k + 40) for k in range(0, n, 40)))


def same_bits(a, b):
    one, other = a.state, b.state
    pairs = [(one.poses.quaternion, other.poses.quaternion), (one.log_weights, other.log_weights)]
    return all(np.array_equal(x, y) for x, y in pairs) and a.estimate.log_evidence == b.estimate.log_evidence


def test_every_backend_tracks_alike_in_one_worker(demo, tracker, device):
    expected, names = demo.track(tracker, "reference")
    assert names == {"numpy:reference"}
    for backend in ("outline", "cpu", "cpu-mt", "auto"):
        report, names = demo.track(tracker, backend)
        assert same_bits(report, expected), backend
        assert all(name.startswith(PREFIX.get(backend, "opencl:")) for name in names)


def test_opengl_tracks_nearly_alike(demo, tracker, device):
    try:
        _, names = demo.track(tracker, "opengl")
    except BackendMissingError as error:
        pytest.skip(error.detail)
    assert all(name.startswith(PREFIX["opengl"]) for name in names)
    ours, theirs = (tracker.track(demo.job(backend)) for backend in ("opengl", "outline"))
    assert np.array_equal(ours.state.poses.position, theirs.state.poses.position)  # the first frame's draws are one
    assert ours.estimate.best_log_likelihood == pytest.approx(theirs.estimate.best_log_likelihood, rel=0.05)
    assert np.corrcoef(ours.state.log_weights, theirs.state.log_weights)[0, 1] > 0.999


def test_the_configuration_offers_what_the_scorer_does():
    assert get_args(get_type_hints(FilterParams)["backend"]) == BACKENDS


def test_auto_loses_no_frame_with_its_device(demo, tracker, failing):
    expected = demo.track(tracker, "reference")[0]
    with pytest.warns(RuntimeWarning, match="DEVICE_NOT_AVAILABLE; going on with numpy:reference"):
        report, names = demo.track(tracker, "auto")
    assert names == {"numpy:reference"}
    assert same_bits(report, expected)


def test_a_device_that_failed_is_tried_again_after_a_while(demo, failing, monkeypatch):
    now = 0.0
    tracker = Tracker()
    tracker._scorers = Scorers(1, lambda: now)
    with pytest.warns(RuntimeWarning, match="DEVICE_NOT_AVAILABLE"):
        tracker.track(demo.job("auto"))
    monkeypatch.setattr(gpu.scorer, "OutlineScorer", OutlineScorer)  # the device is back
    now = REOPEN_S - 1
    assert tracker.track(demo.job("auto")).scorer == "numpy:reference"
    now = REOPEN_S
    assert tracker.track(demo.job("auto")).scorer.startswith("opencl:outline:")
    tracker.close()


def test_a_device_that_no_longer_opens_is_passed_over(demo, tracker, monkeypatch, device):
    def gone(devices):
        raise cl.RuntimeError("clCreateContext failed: DEVICE_NOT_AVAILABLE")

    monkeypatch.setattr("gpu.outline.cl.Context", gone)
    with pytest.warns(RuntimeWarning, match="cannot be opened.*DEVICE_NOT_AVAILABLE"):
        assert tracker.track(demo.job("auto")).scorer == "numpy:reference"


def test_a_named_backend_that_fails_is_an_error_and_the_next_frame_opens_another(demo, tracker, failing, monkeypatch):
    with pytest.raises(ScorerFailedError, match=r"outline.*DEVICE_NOT_AVAILABLE; .* auto would go on") as caught:
        tracker.track(demo.job("outline"))
    assert caught.value.facts == {"backend": "outline"}
    monkeypatch.setattr(gpu.scorer, "OutlineScorer", OutlineScorer)  # the device is back
    assert tracker.track(demo.job("outline")).scorer.startswith("opencl:outline:")


def test_a_named_backend_without_a_device_is_refused(demo, tracker, monkeypatch):
    monkeypatch.setattr(gpu.scorer, "find_devices", lambda: ())
    monkeypatch.setattr(gpu.device, "find_devices", lambda: ())
    with pytest.raises(BackendMissingError, match="'opengl' has no device") as caught:
        tracker.track(demo.job("opengl"))
    assert caught.value.field == "filter.backend"


def test_the_description_says_how_opengl_would_hand_over(tracker, device):
    told = tracker.describe()
    assert told["hand_over"]["name"] in ("gl_sharing", "host_shared", "copy", "none")
    assert told["hand_over"]["reason"]
    assert told["backends"] == list(BACKENDS)


def test_an_image_larger_than_the_scorer_takes_says_the_limit(demo, tracker, device, monkeypatch):
    monkeypatch.setattr("gpu.outline.LARGEST_SIDE", SIZE[0] - 1)
    with pytest.raises(TooLargeError) as caught:
        tracker.track(demo.job("auto"))
    assert caught.value.facts == {"limit": SIZE[0] - 1}
