"""A worker for fast tests: real decoding, no filter. The pose drifts by the frame's hash, so every frame and the
state before it leave their mark on all later answers. It starts fast: what few tests use is loaded when it is used."""

import hashlib
import json
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from gpu.mesh import Mesh, Part
from service.errors import ImageMismatchError, MeshFileError, MissingBlobError
from service.imaging.decode import decode_frame
from service.imaging.split import SplitFrame, split_frames
from service.inference.articulation import Articulation, Joint, Stage, hold
from service.inference.state import Estimate, FilterState, Mode, PoseEstimate, Poses, Spread
from service.models.mesh_glb import mesh_glb
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
    SmoothJob,
    SmoothReport,
)
from service.workers.codec import decode as unpack
from service.workers.restoring import check_state
from service.workers.splitting import SplitJob

if TYPE_CHECKING:
    from service.inference.spin.basins import PassMotion

CUBE = b"cube"
"""A model file that the fake takes: one joint, ``panel``."""

RATE = np.array([0.01, -0.02, 0.03])
"""Rotation rate of every pose against the camera, rad/s, body axes."""


class FakeWorker:
    """Implements ``service.workers.base.Worker``."""

    delay_s = 0.0  # of each frame: long enough to be caught in the middle

    def __init__(self) -> None:
        self.blobs: dict[str, bytes] = {}

    def prepare_model(self, job: ModelJob) -> ModelReport:
        if not job.data.startswith(CUBE):
            raise MeshFileError("the mesh has no faces", field="file")
        stage = Stage("revolute", ("wing",), (0.0, 0.0, 1.0), (0.5, 0.0, 0.0))
        joints = (Joint("panel", "revolute", -90.0, 90.0, 0.0, (stage,)),) if b"joint" in job.data else ()
        return ModelReport(
            faces=12,
            vertices=8,
            size=(1.0, 1.0, 1.0),
            centre=(1.0, 2.0, 3.0),
            watertight=True,
            articulation=Articulation(("body", "wing"), joints),
            warnings=("a cube",),
        )

    def learn_background(self, job: BackgroundJob) -> BackgroundReport:
        image = decode(job.body, job.media_type)
        known = {"frames": 0, "shape": list(image.shape)} if job.background is None else json.loads(job.background)
        if known["shape"] != list(image.shape):
            raise ImageMismatchError("other size", field="body")
        known["frames"] += 1
        height, width = image.shape[:2]
        return BackgroundReport(json.dumps(known).encode(), known["frames"], height, width, 1, 8)

    def split(self, job: SplitJob) -> tuple[SplitFrame, ...]:
        return split_frames(job.body, job.media_type, ser_byte_order=job.ser_byte_order)

    def ready(self, job: ReadyJob) -> None:
        """Nothing is kept."""

    def track(self, job: FrameJob) -> FrameReport:
        self.blobs.update(job.blobs)
        missing = [key for key in (job.model, job.background) if key not in self.blobs]
        if missing:
            raise MissingBlobError.of(missing)
        image = decode(job.body, job.media_type)
        if list(image.shape) != json.loads(self.blobs[job.background])["shape"]:
            raise ImageMismatchError("other size than the background", field="body")
        time.sleep(self.delay_s)
        articulation = hold(job.articulation, job.config.joints.free, job.config.joints.fixed)
        state = drift(job, articulation.n_joints)
        return FrameReport(state, summary(state), {"decode": 1.0, "total": 2.0}, "fake")

    def overlay(self, job: OverlayJob) -> tuple[bytes, ...]:
        self.blobs.update(job.blobs)
        if job.model not in self.blobs:
            raise MissingBlobError.of([job.model])
        image = cv2.cvtColor(decode(job.body, job.media_type), cv2.COLOR_GRAY2BGR)
        blue = np.concatenate([np.full_like(image[..., :1], 255), image[..., 1:]], axis=2)
        drawn = (image if name == "frame" else blue for name in job.show)
        return tuple(cv2.imencode(".png", picture)[1].tobytes() for picture in drawn)

    def mesh(self, job: MeshJob) -> bytes:
        self.blobs.update(job.blobs)
        if job.model not in self.blobs:
            raise MissingBlobError.of([job.model])
        import trimesh

        box = trimesh.creation.box((1.0, 1.0, 1.0))
        parts = tuple(Part(name, box.vertices, box.faces.astype(np.int32)) for name in ("body", "wing"))
        return mesh_glb(Mesh(parts, (1.0, 2.0, 3.0), (1.0, 1.0, 1.0), 0.9, True))

    def restore(self, job: RestoreJob) -> RestoreReport:
        known = {"frames": 0} if job.background is None else json.loads(job.background)
        report = RestoreReport(known["frames"], *((1, 8) if job.background else ()))
        if job.state is None:
            return report
        state = unpack(FilterState, job.state)
        check_state(state, job.n_joints)
        return replace(report, frame_index=state.frame_index, time_s=state.time_s, status=state.status)

    def smooth(self, job: SmoothJob) -> SmoothReport:
        from service.workers.smoothing import smooth_pass

        return smooth_pass(job)

    def motion(self, job: MotionJob) -> "PassMotion":
        from service.workers.motion import motion_of

        return motion_of(job, None)

    def wake(self) -> None:
        """Nothing to begin."""

    def describe(self) -> Mapping[str, Any]:
        return {"scorer": "fake"}

    def close(self) -> None:
        self.blobs.clear()


class SlowWorker(FakeWorker):
    """Takes a little while for each frame."""

    delay_s = 0.03


def decode(body: bytes, media_type: str) -> np.ndarray:
    return decode_frame(body, media_type).image


def drift(job: FrameJob, n_joints: int) -> FilterState:
    n = min(job.config.filter.particles, 50)
    seed = int.from_bytes(hashlib.sha256(job.body).digest()[:8], "little")
    rng = np.random.Generator(np.random.Philox(key=[job.config.filter.seed ^ seed, job.frame_index]))
    before = job.state
    if before is None:
        poses = Poses(np.tile([1.0, 0, 0, 0], (n, 1)), np.zeros((n, 2)), np.zeros(n), np.zeros((n, n_joints)))
    else:
        poses = before.poses
    quaternion = poses.quaternion + 0.1 * rng.normal(size=(n, 4))
    moved = Poses(
        quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True),
        poses.position * 0.9 + rng.normal(size=(n, 2)),
        poses.log_scale + 0.01 * rng.normal(size=n),
        poses.joints + rng.normal(size=poses.joints.shape),
    )
    log_weights = np.log(rng.dirichlet(np.ones(n)))
    rates = np.zeros((n, 6 + n_joints))
    memory = {"seen": np.array([job.frame_index], np.int32)}
    return FilterState(moved, log_weights, rates, job.frame_index, job.time_s, "tracking", memory)


def summary(state: FilterState) -> Estimate:
    weights = np.exp(state.log_weights)
    best = int(np.argmax(weights))
    n_joints = state.poses.joints.shape[1]
    pose = PoseEstimate(
        state.poses.quaternion[best],
        state.poses.position[best],
        float(np.exp(state.poses.log_scale[best])),
        state.poses.joints[best],
        RATE,
    )
    spread = Spread(1.0, 1.0, 1.0, 1.0, 0.5, 0.5, 0.1, np.ones(n_joints), np.eye(6 + n_joints))
    ess = float(1 / np.sum(weights**2))
    mode = Mode(1.0, pose, spread)
    return Estimate(state.status, pose, pose, -1.0, spread, (mode,), len(weights), ess, -float(state.time_s))


class VerySlowWorker(FakeWorker):
    """Takes long enough for a stop in the middle of a frame."""

    delay_s = 3.0


class Recorder(FakeWorker):
    """Keeps what the frames were asked with."""

    jobs: list = []  # noqa: RUF012 -- one worker at a time

    def track(self, job):
        self.jobs.append(job)
        return super().track(job)
