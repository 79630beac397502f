"""The joints of passes that are drawn and tracked: a wing that stands still, follows the Sun, or does neither."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import ndtr

from gpu.mesh import Mesh, load_mesh
from service.bench.mode_streams import draw_references
from service.bench.motion_streams import StreamPlan
from service.bench.told_laws import line_of, told_document
from service.bench.tracked_motion import followed, told_of
from service.inference.params import SessionConfig
from service.inference.pose import rotation_matrices
from service.inference.spin.basins import JOINT_LAWS, JointLaw
from service.inference.state import Array, Poses
from service.simulate.atmosphere import Air
from service.simulate.motion import Motion
from service.simulate.render import Light
from service.simulate.satellite import JOINT, demo_satellite
from service.simulate.scenario import Scenario
from service.simulate.sequence import SimulatedPass
from service.workers.base import ModelJob, ModelReport
from service.workers.panels import sun_tracking
from service.workers.tracker import Tracker

_SIZE = (128, 128)
_HEIGHT_KM = 700.0  # of the orbits that attitude modes are told by
_PHASES_DEG = (10.0, 100.0)
_MOST_D_OVER_R0 = 4.0
_WING_DEG_S = (3.0, 12.0)  # of a wing that does neither
_FREE = replace(SessionConfig().joints, free="all")
_SIDE_DEG = 180.0  # from one side of the wing to the other


@dataclass(frozen=True)
class JointRow:
    """One pass."""

    truth: str  # law of the wing
    told: str
    probability: float  # of what is told
    probability_of_truth: float
    rate_deg_s: float  # of the body
    d_over_r0: float
    constant_error_deg: float | None  # value, or offset from the Sun; None: there is none
    constant_sigma_deg: float | None
    inside: float | None  # probability of the stated region that just reaches the truth
    seconds: float


def run_joints(plan: StreamPlan, passes: int, seed: int, tell: Callable[[JointRow], None]) -> list[JointRow]:
    """``passes`` over the laws in turn, in air from calm to a D/r0 of 4; the Sun is told, the wing is estimated."""
    tracker, rows = Tracker(), []
    try:
        model = tracker.prepare_model(ModelJob(demo_satellite(), "glb"))
        mesh = load_mesh(demo_satellite(), "glb")
        for number in range(passes):
            rng, law = np.random.default_rng([seed, number]), JOINT_LAWS[number % len(JOINT_LAWS)]
            rows.append(_one(tracker, model, mesh, plan, rng, law))
            tell(rows[-1])
    finally:
        tracker.close()
    return rows


def _one(
    tracker: Tracker, model: ModelReport, mesh: Mesh, plan: StreamPlan, rng: np.random.Generator, law: str
) -> JointRow:
    rate = float(np.exp(rng.uniform(*np.log(plan.rates_deg_s))))
    seeing = float(rng.uniform(0.0, _MOST_D_OVER_R0))
    motion = Motion(plan.frames, plan.span_s / plan.frames, rate_deg_s=rate, joint_rate_deg_s=rng.uniform(*_WING_DEG_S))
    light = Light(phase_deg=rng.uniform(*_PHASES_DEG), sun_roll_deg=rng.uniform(0.0, 360.0))
    seed = int(rng.integers(1 << 31))
    scenario = Scenario("", size=_SIZE, seed=seed, motion=motion, light=light, air=Air(d_over_r0=seeing))
    simulated = SimulatedPass(mesh, model.articulation, scenario)
    constant = draw_wing(rng, law, simulated)
    config = replace(told_of(simulated), joints=_FREE)
    found, seconds = _asked(tracker, model, rng, simulated, config)
    error = sigma = inside = None
    if constant is not None:
        value, sigma = found.constants[law]
        error = float((value - constant + 180.0) % 360.0 - 180.0)
        inside = float(2 * ndtr(abs(error) / sigma) - 1)
    return JointRow(
        truth=law,
        told=found.best,
        probability=found.probabilities[found.best],
        probability_of_truth=found.probabilities[law],
        rate_deg_s=rate,
        d_over_r0=seeing,
        constant_error_deg=error,
        constant_sigma_deg=sigma,
        inside=inside,
        seconds=seconds,
    )


def draw_wing(rng: np.random.Generator, law: str, simulated: SimulatedPass) -> float | None:
    """Give a pass's wing its law, from the priors of docs/motion.md; the constant that it has, degrees.

    A wing that does neither turns as the scenario's motion has it.
    """
    poses, column = simulated.track.poses, [joint.name for joint in simulated.articulation.joints].index(JOINT)
    joint = simulated.articulation.joints[column]
    if law == "neither":
        return None
    constant = float(rng.uniform(joint.minimum, joint.maximum))
    values = np.full(len(poses.joints), constant)
    if law == "sun_tracking":
        constant = float(_FREE.sun_tracking_sigma_deg * rng.standard_normal())
        values = facing_the_sun(simulated, column) + constant
        values = joint.minimum + (values - joint.minimum) % (joint.maximum - joint.minimum)
    simulated.track = replace(simulated.track, poses=_with_joint(poses, column, values))
    return constant


def facing_the_sun(simulated: SimulatedPass, column: int) -> Array:
    """(K,) values of a joint that keep one side of its panel to the Sun, as far as its axis lets it; not wrapped."""
    poses, joint = simulated.track.poses, simulated.articulation.joints[column]
    tracking = sun_tracking(simulated.mesh, simulated.articulation, replace(_FREE, sun_tracking=(joint.name,)))
    assert tracking is not None  # a joint is named
    suns = np.array([simulated.light(k).direction() for k in range(len(poses.joints))])
    return np.asarray(np.unwrap(tracking.pointed(poses, suns).joints[:, column], period=_SIDE_DEG))


def _with_joint(poses: Poses, column: int, values: Array) -> Poses:
    joints = poses.joints.copy()
    joints[:, column] = values
    return replace(poses, joints=joints)


def _asked(
    tracker: Tracker, model: ModelReport, rng: np.random.Generator, simulated: SimulatedPass, config: SessionConfig
) -> tuple[JointLaw, float]:
    """The law as the service would tell it, camera and orbit anywhere; and the seconds of the answer."""
    camera = rng.standard_normal(4)
    camera /= np.linalg.norm(camera)
    times = simulated.track.time_s
    sun = rotation_matrices(camera) @ simulated.light(0).direction()
    references = {
        name: rotation_matrices(q) for name, q in draw_references(rng, times, _HEIGHT_KM, towards_sun=sun).items()
    }
    job = followed(tracker, model, simulated, config)
    job = replace(job, cameras=(camera,) * len(times), references=references)
    began = time.perf_counter()
    (found,) = tracker.motion(job).joints
    return found, time.perf_counter() - began


def joint_document(machine: Mapping[str, Any], rows: Sequence[JointRow]) -> dict[str, Any]:
    """The JSON: rows, and for each law how often it was told and how well its constant is known; then all."""
    by_law = {name: [row for row in rows if row.truth == name] for name in JOINT_LAWS}
    lines = [_line(name, mine) for name, mine in by_law.items() if mine]
    return told_document(machine, rows, [*lines, _line("all", rows)])


def _line(name: str, rows: Sequence[JointRow]) -> dict[str, Any]:
    errors = [abs(row.constant_error_deg) for row in rows if row.constant_error_deg is not None]
    inside = np.array([row.inside for row in rows if row.inside is not None])
    known = {
        "constant_med_deg": float(np.median(errors)) if errors else None,
        "cover50": float(np.mean(inside <= 0.5)) if errors else None,
        "cover90": float(np.mean(inside <= 0.9)) if errors else None,
    }
    return {**line_of("law", name, rows), **known}
