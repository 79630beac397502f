"""The filter's types as the device's step takes them, and a step on a small articulated body."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pytest
from gpu_cases import SHAPE, box, mesh_of, sphere

from gpu.device import find_devices
from gpu.scorer import open_scorer
from gpu.step import DeviceStep
from gpu.step_arrays import Body, Bounds, Particles, Stage
from gpu.step_scores import HostCopies
from service.inference.articulation import Articulation, Joint, hold
from service.inference.articulation import Stage as JointStage
from service.inference.domain import Domain, sample_prior
from service.inference.params import PriorParams
from service.inference.state import Poses

LEAST_P = 1e-3  # of statistical tests; their seeds are fixed, so one that passes once passes always
BOOM = Joint("boom", "prismatic", -0.4, 0.4, 0.1, (JointStage("prismatic", ("part1", "part2"), (1.0, 0.0, 0.0)),))
PANEL = Joint(
    "panel",
    "revolute",
    -180.0,
    180.0,
    0.0,
    (JointStage("revolute", ("part2",), (0.0, 0.6, 0.8), origin=(1.0, 0.2, 0.0), depth=1),),
)
HINGE = Joint("hinge", "revolute", -60.0, 60.0, 20.0, (JointStage("revolute", ("part1",), (0.0, 0.0, 1.0), depth=2),))


def body_of(articulation: Articulation) -> Body:
    """The stages of an articulation, deepest first."""
    number = {name: p for p, name in enumerate(articulation.parts)}
    driven = [(s, j, 0.0) for j, joint in enumerate(articulation.joints) for s in joint.stages]
    driven += [(s, None, value) for joint, value in articulation.held for s in joint.stages]
    driven.sort(key=lambda item: -item[0].depth)
    stages = tuple(
        Stage(s.axis, s.origin, s.kind == "prismatic", tuple(number[name] for name in s.parts), j, value)
        for s, j, value in driven
    )
    return Body(len(articulation.parts), articulation.n_joints, stages)


def bounds_of(domain: Domain) -> Bounds:
    low, high = domain.log_scale_bounds
    least, greatest = domain.joint_bounds
    return Bounds(
        np.array([0, 0, low, *least]),
        np.array([domain.width, domain.height, high, *greatest]),
        np.array([0, 0, 0, *np.where(domain.wrapping, 360.0, 0.0)]),
    )


def particles_of(poses: Poses, log_weights: np.ndarray) -> Particles:
    return Particles(poses.quaternion, poses.position, poses.log_scale, poses.joints, log_weights)


def poses_of(particles: Particles) -> Poses:
    return Poses(particles.quaternion, particles.position, particles.log_scale, particles.joints)


@dataclass(frozen=True)
class Case:
    """A body with a turning panel on a sliding boom, a hinge that is held, and the device that steps it."""

    free: tuple[str, ...] = ("boom", "panel")

    @cached_property
    def mesh(self):
        return mesh_of(sphere(4), box((0.3, 0.3, 0.3), (1, 0, 0)), box((0.1, 1.5, 0.8), (1.3, 0, 0)))

    @cached_property
    def domain(self) -> Domain:
        articulation = Articulation(tuple(part.name for part in self.mesh.parts), (BOOM, PANEL, HINGE))
        free = hold(articulation, self.free, {"hinge": 35.0} if self.free else {})
        return Domain(SHAPE[1], SHAPE[0], self.mesh.radius, free, PriorParams())

    @cached_property
    def scorer(self):
        return open_scorer(self.mesh)

    @cached_property
    def step(self) -> DeviceStep:
        usable = [report for report in find_devices() if report.rejected is None]
        if not usable:
            pytest.skip("no OpenCL device answers")
        return DeviceStep(HostCopies(self.scorer, usable[0]), body_of(self.domain.articulation), bounds_of(self.domain))

    def prior(self, n: int, seed: int = 0) -> Poses:
        return sample_prior(np.random.default_rng(seed), self.domain, n)
