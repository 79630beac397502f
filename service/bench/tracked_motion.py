"""The motion of passes that are drawn and tracked: the whole way from images to a rate."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from gpu.mesh import load_mesh
from service.bench.motion_bench import MotionRow, score
from service.bench.motion_streams import StreamPlan
from service.inference.params import SessionConfig
from service.inference.pose import conjugate, exp_so3, log_so3, multiply, rotation_matrices
from service.inference.spin.rigid_body import Motions
from service.inference.state import Array
from service.sessions.lighting import light_at
from service.simulate.atmosphere import Air
from service.simulate.folder import encode_png
from service.simulate.motion import Motion
from service.simulate.satellite import demo_satellite
from service.simulate.scenario import Scenario
from service.simulate.sequence import SimulatedPass
from service.workers.base import BackgroundJob, FrameJob, ModelJob, ModelReport, MotionJob
from service.workers.codec import encode
from service.workers.tracker import Tracker, content_key

_SIZE = (128, 128)
_MOST_D_OVER_R0 = 4.0
_CONFIG = SessionConfig()


def run_tracked(
    plan: StreamPlan, passes: int, seed: int, tell: Callable[[MotionRow], None], *, sun: bool = True
) -> list[MotionRow]:
    """``passes`` of the demo satellite at constant rates, in air from calm to a D/r0 of 4. ``sun``: it is told."""
    tracker, rows = Tracker(), []
    try:
        model = tracker.prepare_model(ModelJob(demo_satellite(), "glb"))
        for number in range(passes):
            rows.append(_tracked(tracker, model, plan, np.random.default_rng([seed, number]), sun))
            tell(rows[-1])
    finally:
        tracker.close()
    return rows


def _tracked(tracker: Tracker, model: ModelReport, plan: StreamPlan, rng: np.random.Generator, sun: bool) -> MotionRow:
    motion = Motion(
        frames=plan.frames,
        frame_interval_s=plan.span_s / plan.frames,
        rate_deg_s=float(np.exp(rng.uniform(*np.log(plan.rates_deg_s)))),
        joints=(),
    )
    seeing = float(rng.uniform(0.0, _MOST_D_OVER_R0))
    scenario = Scenario("", size=_SIZE, seed=int(rng.integers(1 << 31)), motion=motion, air=Air(d_over_r0=seeing))
    simulated = SimulatedPass(load_mesh(demo_satellite(), "glb"), model.articulation, scenario)
    job = followed(tracker, model, simulated, told_of(simulated) if sun else _CONFIG)
    began = time.perf_counter()
    found = tracker.motion(job)
    seconds = time.perf_counter() - began
    truth = told_at(simulated.track.poses.quaternion, simulated.track.time_s, found.reference_s)
    facts = {"frames": plan.frames, "sigma_deg": None, "stays": None, "lasts_s": None}
    return min(
        (score(found, image, facts, seconds) for image in images(truth, found.rotations)),
        key=lambda row: row.vector_error_deg_s,
    )


def images(truth: Motions, rotations: Sequence[Array]) -> list[Motions]:
    """The truth and what the body's symmetries make of it."""
    turned = [Motions(multiply(truth.quaternion, s), truth.rate @ rotation_matrices(s), truth.shape) for s in rotations]
    return [truth, *turned]


def told_of(simulated: SimulatedPass) -> SessionConfig:
    """A session that knows the pass's Sun, as the service does by time and site."""
    x, y, z = simulated.light(0).direction().tolist()
    return replace(_CONFIG, light=replace(_CONFIG.light, sun=(x, y, z)))


def followed(tracker: Tracker, model: ModelReport, simulated: SimulatedPass, config: SessionConfig) -> MotionJob:
    """A pass through the tracker, as the service would ask for its motion."""
    learned = None
    for image in simulated.backgrounds():
        learned = tracker.learn_background(BackgroundJob(config, encode_png(image), "image/png", learned)).background
    assert learned is not None
    mesh, sky = content_key(demo_satellite()), content_key(learned)
    blobs = {mesh: demo_satellite(), sky: learned}
    state, beliefs, counts = None, [], []
    for k, image in enumerate(simulated.frames()):
        given = (config, mesh, "glb", model.articulation, sky, state, k, float(simulated.track.time_s[k]))
        light = light_at(config, {}).light
        report = tracker.track(FrameJob(*given, encode_png(image), "image/png", blobs, model.twins, light=light))
        state = report.state
        beliefs.append(None if report.belief is None else encode(report.belief))
        counts.append(report.estimate.status not in ("no_target", "no_fit", "lost"))
    size = simulated.scenario.size
    return MotionJob(
        config=config,
        model=mesh,
        file_type="glb",
        articulation=model.articulation,
        twins=model.twins,
        width=size[0],
        height=size[1],
        beliefs=tuple(beliefs),
        counts=tuple(counts),
        blobs=blobs,
    )


def told_at(quaternion: Array, times: Array, reference_s: float) -> Motions:
    """A constant rate told at another time, from its orientations (n, 4)."""
    rate = log_so3(multiply(conjugate(quaternion[0]), quaternion[1])) / (times[1] - times[0])
    start = multiply(quaternion[0], exp_so3(rate * (reference_s - times[0])))
    return Motions(start[None], rate[None], np.zeros((1, 0)))
