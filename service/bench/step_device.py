"""The step that stays on the device (``gpu.step``), as a contestant of ``skypose bench step``."""

from __future__ import annotations

import time
from typing import cast

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from gpu.device import find_devices, no_device_reason
from gpu.errors import DeviceError
from gpu.scorer import Scorer
from gpu.step import DeviceStep
from gpu.step_arrays import Body, Bounds, Particles, Stage
from gpu.step_scores import BufferScorer, HostCopies
from service.bench.step_scene import INTERVAL_S, StepScene
from service.inference.articulation import Articulation
from service.inference.domain import Domain
from service.inference.motion import diffusion
from service.inference.params import SessionConfig


class ResidentStep:
    """Resample, jitter, score, weigh and sum up in the device's memory, with the paper's settings."""

    def __init__(self, config: SessionConfig, scorer: Scorer, scene: StepScene, particles: int, seed: int) -> None:
        self._scorer = _TimedBuffers(_on_device(scorer))
        self._step = DeviceStep(self._scorer, device_body(scene.articulation), device_bounds(scene.domain))
        self.device = self._step.name
        self._scene, self._seed, self._exponent = scene, seed, config.likelihood.exponent
        self._deviation = diffusion(config.motion, scene.domain) * np.sqrt(INTERVAL_S)
        state = scene.near_truth(np.random.default_rng(seed), particles, config)
        poses = state.poses
        self._particles = self._step.upload(
            Particles(poses.quaternion, poses.position, poses.log_scale, poses.joints, state.log_weights)
        )

    def run(self, frame: int) -> float:
        """See ``StepRunner``."""
        self._scorer.seconds = 0.0
        self._particles, _ = self._step.run(
            self._seed, frame, self._particles, self._scene.log_ratio, self._deviation, "multinomial", self._exponent
        )
        return self._scorer.seconds


class _TimedBuffers:
    """A scorer with the time that its device took."""

    def __init__(self, scorer: BufferScorer) -> None:
        self.name, self.queue, self.seconds = scorer.name, scorer.queue, 0.0
        self._scorer = scorer

    def score_buffer(self, transforms: cl.Buffer, n: int, log_ratio: NDArray[np.float32]) -> tuple[cl.Buffer, float]:
        """See ``BufferScorer.score_buffer``."""
        self.queue.finish()
        began = time.perf_counter()
        scores = self._scorer.score_buffer(transforms, n, log_ratio)
        self.queue.finish()
        self.seconds += time.perf_counter() - began
        return scores

    def close(self) -> None:
        """The scorer is its owner's to close."""


def _on_device(scorer: Scorer) -> BufferScorer:
    if hasattr(scorer, "score_buffer"):
        return cast(BufferScorer, scorer)
    usable = [report for report in find_devices() if report.rejected is None]
    if not usable:
        raise DeviceError(no_device_reason())
    return HostCopies(scorer, usable[0])


def device_body(articulation: Articulation) -> Body:
    """The stages of an articulation as the device applies them, deepest first."""
    number = {name: p for p, name in enumerate(articulation.parts)}
    driven: list[tuple[Stage, int]] = []
    for j, joint in enumerate(articulation.joints):
        for s in joint.stages:
            moved = tuple(number[name] for name in s.parts)
            driven.append((Stage(s.axis, s.origin, s.kind == "prismatic", moved, j), s.depth))
    for joint, value in articulation.held:
        for s in joint.stages:
            moved = tuple(number[name] for name in s.parts)
            driven.append((Stage(s.axis, s.origin, s.kind == "prismatic", moved, None, value), s.depth))
    driven.sort(key=lambda item: -item[1])
    return Body(len(articulation.parts), articulation.n_joints, tuple(stage for stage, _ in driven))


def device_bounds(domain: Domain) -> Bounds:
    """The prior's bounds as the device keeps them."""
    low, high = domain.log_scale_bounds
    least, greatest = domain.joint_bounds
    return Bounds(
        np.array([0.0, 0.0, low, *least]),
        np.array([domain.width, domain.height, high, *greatest]),
        np.array([0.0, 0.0, 0.0, *np.where(domain.wrapping, 360.0, 0.0)]),
    )
