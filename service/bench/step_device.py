"""The step that stays on the device (``gpu.step``), as a contestant of ``skypose bench step``."""

from __future__ import annotations

import numpy as np

from gpu.device import find_devices, no_device_reason
from gpu.errors import DeviceError
from gpu.scorer import Scorer
from gpu.step import DeviceStep
from gpu.step_arrays import Particles
from gpu.step_scores import BufferScorer, HostCopies, on_device
from service.bench.step_scene import INTERVAL_S, StepScene
from service.inference.motion import diffusion
from service.inference.params import SessionConfig
from service.workers.resident import TimedBuffers, device_body, device_bounds


class ResidentStep:
    """Resample, jitter, score, weigh and sum up in the device's memory, with the paper's settings."""

    def __init__(self, config: SessionConfig, scorer: Scorer, scene: StepScene, particles: int, seed: int) -> None:
        self._scorer = TimedBuffers(_on_device(scorer))
        self._step = DeviceStep(self._scorer, device_body(scene.articulation), device_bounds(scene.domain))
        self.device = self._step.name
        self._scene, self._seed = scene, seed
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
            self._seed, frame, self._particles, self._scene.log_ratio, self._deviation, "multinomial", 1.0
        )
        return self._scorer.seconds


def _on_device(scorer: Scorer) -> BufferScorer:
    if (found := on_device(scorer)) is not None:
        return found
    usable = [report for report in find_devices() if report.rejected is None]
    if not usable:
        raise DeviceError(no_device_reason())
    return HostCopies(scorer, usable[0])
