"""Cases from the simulator: passes drawn at random, made frame by frame and forgotten."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from service.bench.cases import Case, Model, TruthFrame
from service.simulate.folder import encode_png
from service.simulate.scenario import Scenario
from service.simulate.sequence import RANGE_ERROR, SimulatedPass


def random_case(name: str, model: Model, scenario: Scenario, free: tuple[str, ...]) -> Case:
    """A pass drawn at random. ``free`` names the joints that move and are estimated, if it lets any move."""
    moving = free if scenario.motion.joints is None else scenario.motion.joints
    scenario = replace(scenario, motion=replace(scenario.motion, joints=moving))
    return simulated_case(name, model, scenario, moving)


def simulated_case(name: str, model: Model, scenario: Scenario, free: tuple[str, ...]) -> Case:
    """A pass of the simulator as a case."""
    simulated = SimulatedPass(model.mesh, model.articulation, scenario)
    return Case(
        name=name,
        model=model,
        free=free,
        size=scenario.size,
        backgrounds=lambda: (encode_png(image) for image in simulated.backgrounds()),
        frames=lambda: _frames(simulated),
        facts={"d_over_r0": scenario.air.d_over_r0, "phase_deg": scenario.light.phase_deg},
        towards_sun=simulated.light(0).direction(),
        scale_prior=(simulated.told_scale, RANGE_ERROR),
    )


def _frames(simulated: SimulatedPass) -> Iterator[tuple[bytes, TruthFrame]]:
    track, names = simulated.track, [joint.name for joint in simulated.articulation.joints]
    for k, image in enumerate(simulated.frames()):
        truth = TruthFrame(
            time_s=float(track.time_s[k]),
            quaternion=track.poses.quaternion[k],
            position=track.poses.position[k],
            scale=float(np.exp(track.poses.log_scale[k])),
            joints=dict(zip(names, track.poses.joints[k].tolist(), strict=True)),
            visible=bool(track.visible[k]),
        )
        yield encode_png(image), truth
