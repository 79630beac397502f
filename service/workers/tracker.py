"""The worker itself: decode, measure, step. One process, one device; every cache can be rebuilt.

Runs in whatever transport holds it. A frame is a pure function of its job: the generator is Philox keyed by the
session's seed and the frame's index, so a retry, a restart and another worker give the same answer.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Mapping
from typing import Any

from gpu.errors import DeviceError, DeviceLostError
from gpu.kernel_cache import KernelCache
from gpu.mesh import Mesh, MeshError, assemble
from service.errors import BackendMissingError, ConfigError, MeshFileError, MissingBlobError, ScorerFailedError
from service.imaging.background import Background, known_pixels, learn
from service.imaging.decode import Frame as Image
from service.imaging.features import feature_spec
from service.imaging.measurement import measure
from service.imaging.overlay import RGB, draw_overlay, encode_png, for_display
from service.imaging.own_sky import own_sky
from service.imaging.sky import Sky, derive
from service.imaging.split import SplitFrame
from service.imaging.transfer import linear
from service.inference.articulation import Articulation, hold
from service.inference.belief import belief_of
from service.inference.domain import Domain
from service.inference.model.drawing import Lens
from service.inference.params import SessionConfig
from service.inference.spin.basins import PassMotion
from service.inference.state import Frame, Measurement, PoseEstimate
from service.inference.step import step
from service.inference.symmetry import Symmetry
from service.models.mesh_glb import mesh_glb
from service.models.symmetry_group import held_symmetries
from service.workers.base import (
    BackgroundJob,
    BackgroundReport,
    FrameJob,
    FrameReport,
    MeshJob,
    ModelJob,
    ModelReport,
    MotionJob,
    OverlayJob,
    ReadyJob,
    RestoreJob,
    RestoreReport,
    Shown,
    SmoothJob,
    SmoothReport,
)
from service.workers.cache import Cache
from service.workers.decoding import Decoder, InPlace
from service.workers.following import Following, stream_of
from service.workers.full_frame import camera_window, in_full_frame, lens_of, scale_in_window
from service.workers.image_checks import require_same, require_sight, require_size
from service.workers.machine import describe_machine
from service.workers.motion import motion_of
from service.workers.pictures import LitPictures, draw_silhouette
from service.workers.preparing import report_model
from service.workers.resident import ResidentSteps
from service.workers.restoring import check_restored
from service.workers.scoring import Scorers, TimedScorer
from service.workers.shared_scorer import Opener
from service.workers.smoothing import smooth_pass
from service.workers.splitting import SplitJob
from service.workers.visible import HalfShown

LONG_MS = 500.0  # a frame that takes longer may have built kernels, which a worker that is killed later cannot keep
SKIES, SKY_BYTES = 1000, 512 << 20  # kept: every session has its own


class Tracker:
    """Implements ``service.workers.base.Worker``."""

    def __init__(
        self,
        decoder: Decoder | None = None,
        *,
        cached_models: int = 8,
        kernels: KernelCache | None = None,
        opener: Opener | None = None,
    ) -> None:
        self._decoder = decoder or InPlace()
        self._kernels = kernels
        self._meshes: Cache[Mesh] = Cache(cached_models)
        self._scorers = Scorers(cached_models, opener=opener)
        self._steps = ResidentSteps(cached_models)
        self._following = Following(cached_models)
        self._lit_pictures = LitPictures(cached_models)
        self._skies: Cache[Sky] = Cache(SKIES, weigh=sky_bytes, most_bytes=SKY_BYTES)
        self._twins: Cache[tuple[Symmetry, ...]] = Cache(cached_models)

    def prepare_model(self, job: ModelJob) -> ModelReport:
        """Load, check and describe a model file."""
        return report_model(job, self._load(job.data, job.file_type), self._decoder.limits.mesh)

    def learn_background(self, job: BackgroundJob) -> BackgroundReport:
        """Decode an image, or every frame of a file, and add it to the background."""
        background = None if job.background is None else Background.from_bytes(job.background)
        camera, size = job.config.camera, job.size
        for whole in self._decoder.frames(job.body, job.media_type, camera.ser_byte_order):
            size = require_size(whole, size)
            window = camera_window(camera, *size)
            image = window.cut(linear(whole, camera.transfer))
            if background is not None:
                require_same(image, background.shape, background.bits)
            likelihood = job.config.likelihood
            spec = feature_spec(likelihood.feature, image.channels, image.bits, likelihood.gradient_sigma_px)
            known = window.cut_mask(known_pixels(size[1], size[0], job.box, job.border_px))
            if not known.any():
                raise ConfigError("no pixel is left to learn the background from", field="query:box")
            shown, seen = own_sky(image.image, image.bits) if job.own else (image.image, known)
            background = learn(background, shown, image.bits, spec, seen)
        assert background is not None and size is not None, "a decoder yields at least one frame"
        (width, height), channels = size, background.shape[2]
        return BackgroundReport(background.to_bytes(), background.n_frames, height, width, channels, background.bits)

    def ready(self, job: ReadyJob) -> None:
        """Prepare the body, and the templates of a search where its Sun is told."""
        if job.config.filter.method == "bootstrap":
            return
        articulation = hold(job.articulation, job.config.joints.free, job.config.joints.fixed)
        self._following.ready(job, self._mesh(job.model, job.file_type, job.blobs), articulation)

    def split(self, job: SplitJob) -> tuple[SplitFrame, ...]:
        """Every frame of a file as a file of its own."""
        return tuple(self._decoder.split(job.body, job.media_type, job.ser_byte_order))

    def track(self, job: FrameJob) -> FrameReport:
        """Decode a frame, measure it, and run one step of the filter."""
        began = time.perf_counter()
        whole = self._decoder.frame(job.body, job.media_type, job.config.camera.ser_byte_order)
        camera = job.config.camera
        size = require_size(whole, job.size)
        image = camera_window(camera, *size).cut(linear(whole, camera.transfer))
        sky = self._sky(job.config, job.background, job.blobs)
        require_same(image, sky.mean.shape, sky.spec.bits)
        require_sight(job.scale_px, self._mesh(job.model, job.file_type, job.blobs).radius, size)
        decoded = time.perf_counter()
        if job.config.filter.method == "bootstrap":
            report = self._bootstrap(job, image, sky, began, decoded)
        else:
            report = self._follow(job, image, sky, lens_of(camera, *size), began, decoded)
        if self._kernels is not None and report.timing_ms["total"] > LONG_MS:
            self._kernels.keep()
        return report

    def _bootstrap(self, job: FrameJob, image: Image, sky: Sky, began: float, decoded: float) -> FrameReport:
        """A frame of the published filter."""
        log_ratio, log_constant = measure(image.image, sky)
        log_ratio.flags.writeable = False  # scorers know a map again by its identity
        measured = time.perf_counter()
        articulation = hold(job.articulation, job.config.joints.free, job.config.joints.fixed)
        mesh = self._mesh(job.model, job.file_type, job.blobs)
        height, width = image.image.shape[:2]
        within = scale_in_window(job.scale_px, job.config.camera)
        frame = Frame(job.frame_index, job.time_s, Measurement(log_ratio, log_constant))
        chosen = job.config.filter
        rng = stream_of(chosen.seed, job.frame_index)
        with self._scorers.lend(job.model, chosen.backend, mesh, chosen.particles) as scorer:
            timed = TimedScorer(scorer, articulation, log_ratio)
            shows_half = HalfShown(timed, mesh, (height, width))
            domain = Domain(width, height, mesh.radius, articulation, job.config.prior, within, shows_half)
            resident = self._steps.of(scorer, job.config, domain)
            state, estimate = step(rng, job.state, frame, timed, job.config, domain, resident)
            scored_by, score_s = scorer.name, timed.seconds
            if resident is not None and resident.used:
                scored_by, score_s = f"{scored_by} (step on the device)", resident.seconds
        belief = belief_of(state, domain)
        estimate = in_full_frame(estimate, job.config.camera)
        done = time.perf_counter()
        timing = {
            "decode": decoded - began,
            "measure": measured - decoded,
            "score": score_s,
            "step": done - measured,
            "total": done - began,
        }
        return FrameReport(state, estimate, {k: round(v * 1e3, 3) for k, v in timing.items()}, scored_by, belief)

    def _follow(
        self, job: FrameJob, image: Image, sky: Sky, lens: Lens | None, began: float, decoded: float
    ) -> FrameReport:
        """A frame of the filter that follows the light. Raises ``BackendMissingError``, ``ScorerFailedError``."""
        articulation = hold(job.articulation, job.config.joints.free, job.config.joints.fixed)
        mesh, twins = self._mesh(job.model, job.file_type, job.blobs), self._held_twins(job, articulation)
        try:
            state, estimate, belief = self._following.track(job, image, sky, mesh, articulation, twins, lens)
        except DeviceLostError as error:
            self._following.close()  # what it kept was on that device
            raise ScorerFailedError(str(error)) from error
        except DeviceError as error:
            raise BackendMissingError(f"{error}; a CPU is one with PoCL (pocl-opencl-icd)", field="filter") from error
        done = time.perf_counter()
        timing = {
            "decode": decoded - began,
            "measure": 0.0,
            "score": 0.0,
            "step": done - decoded,
            "total": done - began,
        }
        return FrameReport(state, estimate, {k: round(v * 1e3, 3) for k, v in timing.items()}, "light", belief)

    def _held_twins(self, job: FrameJob, articulation: Articulation) -> tuple[Symmetry, ...]:
        """The model's symmetries that are left with some joints held."""
        return self._twins.get(
            f"{job.model}:{articulation}:{job.twins}",
            lambda: held_symmetries(job.twins, job.articulation, articulation),
        )

    def overlay(self, job: OverlayJob) -> tuple[bytes, ...]:
        """PNGs of a frame as ``job.show`` asks, in its order."""
        image = self._decoder.frame(job.body, job.media_type, job.config.camera.ser_byte_order)
        drawn: dict[Shown, RGB] = {}
        if "frame" in job.show:
            drawn["frame"] = for_display(image.image)
        mesh = self._mesh(job.model, job.file_type, job.blobs) if set(job.show) - {"frame"} else None
        if mesh is not None and "overlay" in job.show:
            pose = PoseEstimate(job.quaternion, job.position, job.scale, job.joints)
            height, width = image.image.shape[:2]
            lens = lens_of(job.config.camera, width, height, whole=True)
            mask = draw_silhouette(mesh, job.articulation, pose, (height, width), lens)
            drawn["overlay"] = draw_overlay(image.image, mask)
        if mesh is not None and {"model", "residual"} & set(job.show):
            assert job.background is not None, "what is left over is left over of the light above a sky"
            drawn |= self._lit_pictures.draw(job, image, self._sky(job.config, job.background, job.blobs), mesh)
        return tuple(encode_png(drawn[name]) for name in job.show)

    def mesh(self, job: MeshJob) -> bytes:
        """GLB of a model's prepared mesh."""
        return mesh_glb(self._mesh(job.model, job.file_type, job.blobs), job.root)

    def restore(self, job: RestoreJob) -> RestoreReport:
        """Check what a checkpoint brings."""
        return check_restored(job)

    def smooth(self, job: SmoothJob) -> SmoothReport:
        """Backwards over a pass that was tracked."""
        return smooth_pass(job)

    def motion(self, job: MotionJob) -> PassMotion:
        """How the object turned over a pass."""
        return motion_of(job, self._mesh(job.model, job.file_type, job.blobs))

    def describe(self) -> Mapping[str, Any]:
        """This machine and what is installed."""
        return describe_machine()

    def wake(self) -> None:
        """The decoder comes up beside whatever is done meanwhile."""
        self._decoder.prestart()

    def close(self) -> None:
        """Release the device and the decoder."""
        self._decoder.close()
        self._steps.close()
        self._following.close()
        self._lit_pictures.close()
        self._scorers.close()
        self._meshes.clear()
        self._skies.clear()
        self._twins.clear()
        if self._kernels is not None:
            self._kernels.keep()  # those of backends that sessions chose
            self._kernels.close()

    def _mesh(self, key: str, file_type: str, blobs: Mapping[str, bytes]) -> Mesh:
        return self._meshes.get(key, lambda: self._load(_blob(blobs, key), file_type))

    def _sky(self, config: SessionConfig, key: str, blobs: Mapping[str, bytes]) -> Sky:
        chosen = config.likelihood.feature, config.likelihood.gradient_sigma_px
        return self._skies.get(f"{key}:{chosen}", lambda: derive(Background.from_bytes(_blob(blobs, key)), *chosen))

    def _load(self, data: bytes, file_type: str) -> Mesh:
        try:
            return assemble(self._decoder.parts(data, file_type))
        except MeshError as error:
            raise MeshFileError(str(error), field="file") from error


def content_key(data: bytes) -> str:
    """SHA-256 in hexadecimal: how blobs are named."""
    return hashlib.sha256(data).hexdigest()


def _blob(blobs: Mapping[str, bytes], key: str) -> bytes:
    if key not in blobs:
        raise MissingBlobError.of([key])
    return blobs[key]


def sky_bytes(sky: Sky) -> int:
    """Memory that a sky takes."""
    return sky.mean.nbytes + sky.log_density.nbytes + (0 if sky.unsure is None else sky.unsure.nbytes)
