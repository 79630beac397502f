"""The paper's update on the scorer's device (``gpu.step``), for sessions with many particles."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from typing import cast

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from gpu.device import find_devices
from gpu.errors import ScorerError
from gpu.scorer import Scorer
from gpu.step import RESAMPLERS, DeviceStep, Resampler
from gpu.step_arrays import Body, Bounds, Particles, Stage
from gpu.step_scores import BufferScorer, HostCopies, on_device
from service.inference.articulation import Articulation
from service.inference.domain import Domain
from service.inference.motion import diffusion
from service.inference.params import SessionConfig
from service.inference.pose import pick
from service.inference.state import Array, FilterState, Frame, Outcome, Poses
from service.inference.step import bootstrap_update, weighed
from service.workers.cache import Cache

LEAST_PARTICLES = 5_000  # of `auto`: with fewer the host's part of a step is a few milliseconds (skypose bench step)


class ResidentSteps:
    """Steps that stay on a device, one per scorer and domain. Owned and used by one thread."""

    def __init__(self, size: int) -> None:
        self._kept: Cache[tuple[DeviceStep, TimedBuffers]] = Cache(size, lambda kept: kept[0].close())

    def of(self, scorer: Scorer, config: SessionConfig, domain: Domain) -> ResidentUpdate | None:
        """The update of a session on the device of its scorer; None where ``bootstrap_update`` is to make it."""
        chosen = config.filter
        if chosen.method != "bootstrap" or chosen.step == "host" or chosen.resampler not in RESAMPLERS:
            return None
        driven = (*domain.articulation.joints, *(joint for joint, _ in domain.articulation.held))
        if any(stage.ratio != 1 for joint in driven for stage in joint.stages):
            return None  # the device's stages move by the joint's value
        buffers = on_device(scorer)
        if chosen.step == "auto" and (chosen.particles < LEAST_PARTICLES or buffers is None or not on_gpu(buffers)):
            return None
        usable = [report for report in find_devices() if report.rejected is None]
        if buffers is None and not usable:
            return None
        key = f"{id(buffers or scorer)}:{domain}"  # what is kept holds the scorer, so that its id stays its own
        return ResidentUpdate(
            lambda: self._kept.get(key, lambda: _open(buffers or HostCopies(scorer, usable[0]), domain))
        )

    def close(self) -> None:
        """Wait for the devices."""
        self._kept.clear()


class ResidentUpdate:
    """Stands in for ``bootstrap_update``. ``seconds`` of it the scorer took; ``used``: the device made the update."""

    def __init__(self, make: Callable[[], tuple[DeviceStep, TimedBuffers]]) -> None:
        self._make = make
        self.used, self.seconds = False, 0.0

    def __call__(
        self,
        rng: np.random.Generator,
        state: FilterState | None,
        frame: Frame,
        score: Callable[[Poses], Array],
        config: SessionConfig,
        domain: Domain,
    ) -> Outcome:
        """See ``bootstrap_update``, which makes the first update, and those that the device cannot."""
        if state is None or len(state.poses) != config.filter.particles:
            return bootstrap_update(rng, state, frame, score, config, domain)
        try:
            device, scorer = self._make()
            scorer.seconds = 0.0
            poses, log_likelihood = run(device, state, frame, score, config, domain)
        except ScorerError as error:
            warnings.warn(f"{error}; this step is made on the host", RuntimeWarning, stacklevel=2)
            return bootstrap_update(rng, state, frame, score, config, domain)
        self.used, self.seconds = True, scorer.seconds
        return weighed(poses, log_likelihood, domain)


def run(
    device: DeviceStep,
    state: FilterState,
    frame: Frame,
    score: Callable[[Poses], Array],
    config: SessionConfig,
    domain: Domain,
) -> tuple[Poses, Array]:
    """Draw, move and score on the device: the particles and the (N,) particle term of Eq. 4.

    The device holds moves against the bounds of each coordinate. What then shows less than half of the body is put back
    here, and scored by ``score``.
    """
    old = state.poses
    before = Particles(old.quaternion, old.position, old.log_scale, old.joints, state.log_weights)
    resampler = cast(Resampler, config.filter.resampler)  # one of ``RESAMPLERS``
    deviation = diffusion(config.motion, domain) * np.sqrt(max(frame.time_s - state.time_s, 0.0))
    seed, particles = config.filter.seed, device.upload(before)
    ancestors = device.resample(seed, frame.index, particles, resampler)
    moved = device.move(seed, frame.index, particles, ancestors, deviation)
    log_likelihood = device.log_likelihoods(moved, frame.measurement.log_ratio)
    new = device.download(moved)
    quaternion = new.quaternion / np.linalg.norm(new.quaternion, axis=1, keepdims=True)  # float32's unit
    poses = domain.wrap(Poses(quaternion, new.position, new.log_scale, new.joints))
    if domain.shows_half is None:
        return poses, log_likelihood
    origins = old[device.drawn(ancestors, len(old))]
    unseen = np.flatnonzero(~domain.shows_half(poses))
    unseen = unseen[domain.shows_half(origins[unseen])]
    if not len(unseen):
        return poses, log_likelihood
    log_likelihood[unseen] = score(origins[unseen])
    left = np.zeros(len(old), np.bool_)
    left[unseen] = True
    return pick(left, origins, poses), log_likelihood


def on_gpu(scorer: BufferScorer) -> bool:
    """On a CPU's device the host's part of a step is as fast."""
    return bool(scorer.queue.device.type & cl.device_type.GPU)


class TimedBuffers:
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


def _open(scorer: BufferScorer, domain: Domain) -> tuple[DeviceStep, TimedBuffers]:
    timed = TimedBuffers(scorer)
    return DeviceStep(timed, device_body(domain.articulation), device_bounds(domain)), timed


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
    first, last = domain.position_bounds
    least, greatest = domain.joint_bounds
    return Bounds(
        np.array([*first, low, *least]),
        np.array([*last, high, *greatest]),
        np.array([0.0, 0.0, 0.0, *np.where(domain.wrapping, 360.0, 0.0)]),
    )
