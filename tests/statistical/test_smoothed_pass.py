"""Simulated passes of the demo satellite: what the smoother gains on the filter."""

import numpy as np
import pytest

from gpu.mesh import load_mesh
from service.bench.tracked_motion import images, told_at
from service.inference.params import JointParams, SessionConfig
from service.inference.pose import angle_between, conjugate, log_so3, multiply
from service.simulate.folder import encode_png
from service.simulate.motion import Motion
from service.simulate.satellite import demo_satellite
from service.simulate.scenario import Scenario
from service.simulate.sequence import SimulatedPass
from service.workers.base import BackgroundJob, FrameJob, ModelJob, MotionJob, SmoothJob
from service.workers.codec import encode
from service.workers.tracker import Tracker, content_key

SEEDS = range(3)
SIZE = (128, 128)
CONFIG = SessionConfig(joints=JointParams(free="all"))


@pytest.fixture(scope="module")
def tracker():
    tracker = Tracker()
    yield tracker
    tracker.close()


def errors(seed: int, tracker: Tracker, report) -> dict[str, float]:
    """Medians over a pass, of the filter's answers and of the smoothed ones."""
    scenario = Scenario("", size=SIZE, seed=seed, motion=Motion(frames=20, rate_deg_s=8.0))
    simulated = SimulatedPass(load_mesh(demo_satellite(), "glb"), report.articulation, scenario)
    learned = None
    for image in simulated.backgrounds():
        learned = tracker.learn_background(BackgroundJob(CONFIG, encode_png(image), "image/png", learned)).background
    blobs = {content_key(data): data for data in (demo_satellite(), learned)}
    model, background = blobs
    state, filtered, beliefs = None, [], []
    for k, image in enumerate(simulated.frames()):
        time_s = float(simulated.track.time_s[k])
        job = FrameJob(
            *(CONFIG, model, "glb", report.articulation, background, state, k, time_s),
            *(encode_png(image), "image/png", blobs, report.twins),
        )
        done = tracker.track(job)
        state, filtered, beliefs = done.state, [*filtered, done.estimate], [*beliefs, encode(done.belief)]
    job = SmoothJob(CONFIG, report.articulation, report.twins, *SIZE, tuple(beliefs), len(beliefs))
    found = compare(simulated.track, filtered, tracker.smooth(job).estimates)
    asked = MotionJob(
        *(CONFIG, model, "glb", report.articulation, report.twins, *SIZE),
        *(tuple(beliefs), (True,) * len(beliefs)),
        blobs=blobs,
    )
    return found | of_the_pass(simulated.track, tracker.motion(asked))


def of_the_pass(track, motion) -> dict[str, float]:
    """The rate of all frames together, against the truth as the body's symmetries show it."""
    truth = told_at(track.poses.quaternion, track.time_s, motion.reference_s)
    lead = motion.best_of("constant_rate")
    off = min((lead.motion.rate[0] - one.rate[0] for one in images(truth, motion.rotations)), key=np.linalg.norm)
    stated = float(off @ np.linalg.solve(lead.covariance[3:6, 3:6], off))
    return {"motion deg/s": np.rad2deg(np.linalg.norm(off)), "motion sigmas": np.sqrt(stated / 3)}


def compare(track, filtered, smoothed) -> dict[str, float]:
    true = track.poses.quaternion
    rate = log_so3(multiply(conjugate(true[0]), true[1])) / (track.time_s[1] - track.time_s[0])
    found = {}
    for name, estimates in (("filtered", filtered), ("smoothed", smoothed)):
        off = [float(angle_between(e.modes[0].pose.quaternion, q)) for e, q in zip(estimates, true, strict=True)]
        rates = [e.rates for e in estimates if e.rates is not None]
        found[f"{name} deg"] = np.rad2deg(np.median(off))
        found[f"{name} deg/s"] = np.rad2deg(np.median([np.linalg.norm(r.velocity[:3] - rate) for r in rates]))
        found[f"{name} spread deg"] = np.median([e.modes[0].spread.orientation_deg for e in estimates])
        z = [np.abs(r.velocity[:3] - rate) / r.deviation[:3] for r in rates]
        found[f"{name} within 2 sigma"] = np.mean(np.array(z) < 2)
    return found


@pytest.mark.long
def test_smoothing_gains_on_the_filter(tracker):
    """Orientation and rate, geometric means over the seeds of the passes' medians, with an honest spread.

    Means are held against means: a frame's ``best`` is the likelihood's alone.
    """
    report = tracker.prepare_model(ModelJob(demo_satellite(), "glb"))
    passes = [errors(seed, tracker, report) for seed in SEEDS]
    found = {name: float(np.exp(np.mean(np.log([one[name] for one in passes])))) for name in passes[0]}
    assert found["smoothed deg"] < found["filtered deg"]
    assert found["smoothed deg/s"] < found["filtered deg/s"]
    # A filtered spread is nearly that of one frame already: frames of one body err alike, and later ones say little.
    assert found["smoothed spread deg"] < 1.1 * found["filtered spread deg"]
    assert found["smoothed within 2 sigma"] > 0.8
    # All frames together tell the rate far better than any of them.
    assert found["motion deg/s"] < 0.5 * found["smoothed deg/s"]
    assert found["motion sigmas"] < 2.0
