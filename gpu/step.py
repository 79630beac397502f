"""The filter's step on the device: resample (Eq. 6), jitter, score, weigh, and the sums of Eq. 5.

The one place where this package knows weights. Particles stay in the device's memory from frame to frame; the host
sees a few hundred numbers per step. Equal in distribution to ``service.inference.step.bootstrap_update``, with random
numbers of its own: the same seed, frame and particles give the same bits on one device.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, TypeVar, get_args

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gpu.errors import ScorerError
from gpu.program import KernelArgument, build, constant, device_errors
from gpu.step_arrays import Body, Bounds, DeviceParticles, Floats, Particles, Summary, device_layout
from gpu.step_moments import Mean, Spread, mean_of, spread_of
from gpu.step_scores import TRANSFORM_BYTES, BufferScorer

FILES = ("step_random.cl", "step_rotation.cl", "step_motion.cl", "step_resample.cl", "step_weights.cl")
GROUP = 128  # work-items per group; a power of two
GROUPS_PER_UNIT = 8  # of the device, that share out a sum
TRANSFORMS_BYTES = 64 << 20  # of the transforms that exist at one time
WEIGHT_BITS = 62  # of the sum of all weights
LARGEST_COUNT = 10_000_000
MEAN_STEPS = 10
CLOSE_RAD = 1e-5  # a mean rotation that moves less has arrived: float32 sums tell little more

Resampler = Literal["multinomial", "systematic"]
RESAMPLERS = get_args(Resampler)  # each is a kernel's name
Arguments = tuple[KernelArgument, ...]
Number = TypeVar("Number", bound=np.generic)


class DeviceStep:
    """Steps of one body's particles on one scorer's device. Owned, used and closed by one thread."""

    def __init__(self, scorer: BufferScorer, body: Body, bounds: Bounds) -> None:
        self.name = f"step:{scorer.name}"
        self._scorer, self._queue, self._context = scorer, scorer.queue, scorer.queue.context
        self._body = body
        self._low, self._period = np.asarray(bounds.low, dtype=np.float64), np.asarray(bounds.period, dtype=np.float64)
        sizes = {"GROUP": GROUP, "JOINTS": body.n_joints, "PARTS": body.n_parts, "STAGES": len(body.stages)}
        with device_errors(self.name):
            program = build(self._context, *FILES, options=[f"-D{name}={value}" for name, value in sizes.items()])
            self._kernels = {kernel.function_name: kernel for kernel in program.all_kernels()}
            self._stages = tuple(constant(self._context, a) for a in body.stage_arrays())
            self._bounds = tuple(self._upload(a) for a in (bounds.low, bounds.high, bounds.period))

    def upload(self, particles: Particles) -> DeviceParticles:
        """Bring particles to the device. Raises ``ScorerError`` where no weight is positive or a pose is not finite."""
        if particles.joints.shape != (len(particles), self._body.n_joints):
            raise ScorerError(f"joints are {particles.joints.shape}, not (N, {self._body.n_joints})")
        arrays, log_total = device_layout(particles)
        with device_errors(self.name):
            rotations, values, log_weights = (constant(self._context, a) for a in arrays)
        return DeviceParticles(len(particles), rotations, values, log_weights, log_total)

    def download(self, particles: DeviceParticles) -> Particles:
        """Bring particles back, for storing or showing them."""
        n = particles.n
        with device_errors(self.name):
            rotations = self._fetch(particles.rotations, np.empty((n, 4), np.float32))
            values = self._fetch(particles.values, np.empty((3 + self._body.n_joints, n), np.float32))
            log_weights = self._fetch(particles.log_weights, np.empty(n, np.float32))
        return Particles(
            quaternion=np.roll(rotations, 1, axis=1).astype(np.float64),
            position=values[:2].T.astype(np.float64),
            log_scale=values[2].astype(np.float64),
            joints=values[3:].T.astype(np.float64),
            log_weights=log_weights.astype(np.float64) - particles.log_total,
        )

    def run(
        self,
        seed: int,
        frame: int,
        particles: DeviceParticles,
        log_ratio: NDArray[np.float32],
        deviation: Floats,
        resampler: Resampler = "systematic",
        exponent: float = 1.0,
    ) -> tuple[DeviceParticles, Summary]:
        """One whole update by a frame: resample, move, weigh. ``particles`` is left as it is.

        ``log_ratio`` is the (H, W) map of Eq. 3, ``deviation`` (6 + J,) the jitter in tangent units, ``exponent``
        the power of the likelihood. Raises ``ScorerError``, or ``DeviceLostError`` where the device fails.
        """
        ancestors = self.resample(seed, frame, particles, resampler)
        return self.weigh(self.move(seed, frame, particles, ancestors, deviation), log_ratio, exponent)

    def resample(self, seed: int, frame: int, particles: DeviceParticles, resampler: Resampler) -> cl.Buffer:
        """(N,) int32 ancestors: particle j is drawn N w_j times on average, and never where w_j is zero."""
        n = particles.n
        if n > LARGEST_COUNT:
            raise ScorerError(f"{n} particles are more than {LARGEST_COUNT}")
        if resampler not in RESAMPLERS:
            raise ScorerError(f"resampler {resampler!r} is not one of {', '.join(RESAMPLERS)}")
        heaviest = np.float32(2.0 ** (WEIGHT_BITS - (n - 1).bit_length()))
        tiles = -(-n // (2 * GROUP))
        with device_errors(self.name):
            cumulative, tile_sums = self._room(8 * n), self._room(8 * tiles)
            self._launch("sum_tiles", tiles, particles.log_weights, np.int32(n), heaviest, cumulative, tile_sums)
            self._launch("sum_sums", 1, tile_sums, np.int32(tiles))
            self._launch_each("add_sums", n, cumulative, np.int32(n), tile_sums)
            ancestors = self._room(4 * n)
            self._launch_each(resampler, n, cumulative, np.int32(n), *_key(seed, frame), ancestors)
        return ancestors

    def drawn(self, ancestors: cl.Buffer, n: int) -> NDArray[np.int32]:
        """(n,) the ancestors that ``resample`` drew, on the host."""
        with device_errors(self.name):
            return self._fetch(ancestors, np.empty(n, np.int32))

    def move(
        self, seed: int, frame: int, particles: DeviceParticles, ancestors: cl.Buffer, deviation: Floats
    ) -> DeviceParticles:
        """The drawn particles, each moved by a Gaussian step of ``deviation`` (6 + J,); their weights are equal."""
        n = particles.n
        if np.shape(deviation) != (6 + self._body.n_joints,):
            raise ScorerError(f"deviations are {np.shape(deviation)}, not ({6 + self._body.n_joints},)")
        with device_errors(self.name):
            moved = replace(
                particles,
                rotations=self._room(16 * n),
                values=self._room(4 * n * len(self._period)),
                log_weights=self._upload(np.zeros(n)),
                log_total=float(np.log(n)),
            )
            before: Arguments = (particles.rotations, particles.values, ancestors, np.int32(n))
            jitter: Arguments = (self._upload(deviation), *self._bounds, *_key(seed, frame))
            self._launch_each("propagate", n, *before, *jitter, moved.rotations, moved.values)
        return moved

    def weigh(
        self, particles: DeviceParticles, log_ratio: NDArray[np.float32], exponent: float = 1.0
    ) -> tuple[DeviceParticles, Summary]:
        """Weigh particles of equal weight by their likelihood (Eq. 4) to the power of ``exponent``, and sum up."""
        n = particles.n
        with device_errors(self.name):
            scores, unit = self._score(particles, log_ratio)
            best_score, best = self._best(scores, n)
            log_weights = self._room(4 * n)
            nats = np.float32(unit * exponent)
            self._launch_each("weigh", n, scores, np.int32(n), np.int64(best_score), nats, log_weights)
            weighed = replace(particles, log_weights=log_weights)
            mean, spread = self._moments(weighed)
        summary = Summary(
            quaternion=mean.rotation.as_quat(canonical=True, scalar_first=True),
            position=mean.position,
            scale=mean.scale,
            joints=mean.joints,
            covariance=spread.covariance,
            scale_deviation=spread.scale_deviation,
            ess=mean.ess,
            log_evidence=best_score * unit * exponent + float(np.log(mean.total / n)),
            best=best,
            best_log_likelihood=best_score * unit,
        )
        return replace(weighed, log_total=float(np.log(mean.total))), summary

    def log_likelihoods(self, particles: DeviceParticles, log_ratio: NDArray[np.float32]) -> Floats:
        """(N,) the particle term of Eq. 4, for a host that weighs the particles itself."""
        with device_errors(self.name):
            scores, unit = self._score(particles, log_ratio)
            return np.asarray(self._fetch(scores, np.empty(particles.n, np.int64)) * unit, dtype=np.float64)

    def part_transforms(self, particles: DeviceParticles, first: int, count: int) -> cl.Buffer:
        """(count, P, 3, 4) float32 transforms of the particles from ``first`` on: body point at rest -> px."""
        where = np.int32(particles.n), np.int32(first), np.int32(count)
        with device_errors(self.name):
            transforms = self._room(TRANSFORM_BYTES * self._body.n_parts * count)
            head = particles.rotations, particles.values, *where
            self._launch_each("part_transforms", count * self._body.n_parts, *head, *self._stages, transforms)
        return transforms

    def close(self) -> None:
        """Wait for the device; the scorer is its owner's to close."""
        self._queue.finish()

    def _score(self, particles: DeviceParticles, log_ratio: NDArray[np.float32]) -> tuple[cl.Buffer, float]:
        """(N,) int64 scores and their unit, in batches, so that the transforms of a million particles need no room."""
        n, size = particles.n, max(1, TRANSFORMS_BYTES // (TRANSFORM_BYTES * self._body.n_parts))
        all_scores, unit = self._room(8 * n), 1.0
        for first in range(0, n, size):
            count = min(size, n - first)
            transforms = self.part_transforms(particles, first, count)
            scores, unit = self._scorer.score_buffer(transforms, count, log_ratio)
            cl.enqueue_copy(self._queue, all_scores, scores, byte_count=8 * count, dst_offset=8 * first)
            self._queue.finish()  # frees this batch's buffers before the next one's are made
        return all_scores, unit

    def _best(self, scores: cl.Buffer, n: int) -> tuple[int, int]:
        """The highest score in units, and the first particle that has it."""
        groups = self._groups(n)
        best_scores, best = self._room(8 * groups), self._room(4 * groups)
        self._launch("find_best", groups, scores, np.int32(n), best_scores, best)
        values = self._fetch(best_scores, np.empty(groups, np.int64))
        which = self._fetch(best, np.empty(groups, np.int32))
        top = int(values.max())
        return top, int(which[values == top].min())

    def _moments(self, particles: DeviceParticles) -> tuple[Mean, Spread]:
        """The expected pose and the spread about it (Eq. 5)."""
        n, n_joints = particles.n, self._body.n_joints
        weighted = particles.rotations, particles.values, particles.log_weights, np.int32(n)
        sums = self._sums("sums_for_mean", 15 + 3 * n_joints, n, *weighted)
        mean = self._refine(particles, mean_of(sums, self._low, self._period))
        dimension = 6 + n_joints
        n_sums = dimension * (dimension + 1) // 2 + 1
        about = self._upload(mean.numbers()), self._bounds[2]
        return mean, spread_of(self._sums("sums_for_spread", n_sums, n, *weighted, *about), mean.total, dimension)

    def _refine(self, particles: DeviceParticles, mean: Mean) -> Mean:
        """Move the mean rotation to where the weighted rotation vectors about it cancel (Karcher)."""
        weighted = particles.rotations, particles.log_weights, np.int32(particles.n)
        for _ in range(MEAN_STEPS):
            sums = self._sums("sums_for_rotation", 3, particles.n, *weighted, self._upload(mean.numbers()))
            step = sums / mean.total
            mean = replace(mean, rotation=mean.rotation * Rotation.from_rotvec(step))
            if float(np.linalg.norm(step)) < CLOSE_RAD:
                break
        return mean

    def _sums(self, kernel: str, n_sums: int, n: int, *arguments: KernelArgument) -> Floats:
        """(n_sums,) sums over n particles."""
        groups = self._groups(n)
        items = groups * GROUP
        parts, sums = self._room(4 * n_sums * items), self._room(4 * n_sums)
        self._launch(kernel, groups, *arguments, parts)
        self._launch("add_parts", n_sums, parts, np.int32(items), sums)
        return self._fetch(sums, np.empty(n_sums, np.float32)).astype(np.float64)

    def _groups(self, n: int) -> int:
        """Work-groups among which n particles are shared out where each gives one result."""
        return min(GROUPS_PER_UNIT * self._queue.device.max_compute_units, -(-n // GROUP))

    def _launch(self, kernel: str, groups: int, *arguments: KernelArgument) -> None:
        self._kernels[kernel](self._queue, (groups * GROUP,), (GROUP,), *arguments)

    def _launch_each(self, kernel: str, n: int, *arguments: KernelArgument) -> None:
        self._launch(kernel, -(-n // GROUP), *arguments)

    def _room(self, n_bytes: int) -> cl.Buffer:
        return cl.Buffer(self._context, cl.mem_flags.READ_WRITE, n_bytes)

    def _upload(self, values: Floats) -> cl.Buffer:
        return constant(self._context, np.asarray(values, dtype=np.float32))

    def _fetch(self, buffer: cl.Buffer, out: NDArray[Number]) -> NDArray[Number]:
        cl.enqueue_copy(self._queue, out, buffer)
        return out


def _key(seed: int, frame: int) -> tuple[np.uint64, np.uint32]:
    """The generator's key and the frame's part of its counter. Raises ``ValueError`` where they do not fit."""
    if not (0 <= seed < 2**64 and 0 <= frame < 2**32):
        raise ValueError(f"seed {seed} or frame {frame} does not fit into 64 and 32 bits")
    return np.uint64(seed), np.uint32(frame)
