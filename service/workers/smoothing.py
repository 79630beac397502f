"""A pass smoothed: beliefs in, estimates out. Needs neither images nor device."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.inference.articulation import hold
from service.inference.belief import Belief, rates_near
from service.inference.domain import Domain
from service.inference.mesh_error import stated_belief
from service.inference.motion import motion_noise
from service.inference.rotation_rate import rotation_rate
from service.inference.smoothed import summarise_belief
from service.inference.smoother import Space, smooth
from service.inference.state import Estimate, FilterState, Poses
from service.models.symmetry_group import held_symmetries
from service.workers.base import SmoothJob, SmoothReport
from service.workers.codec import decode
from service.workers.full_frame import camera_window, smoothed_in_full_frame


def smooth_pass(job: SmoothJob) -> SmoothReport:
    """The smoothed marginals of the first ``job.count`` frames. Raises ``CheckpointError`` for a broken belief."""
    articulation = hold(job.articulation, job.config.joints.free, job.config.joints.fixed)
    camera = job.config.camera
    domain = Domain(*camera_window(camera, job.width, job.height).size, job.radius, articulation, job.config.prior)
    filtered = [None if packed is None else decode(Belief, packed) for packed in job.beliefs]
    each = any(belief is not None and belief.each for belief in filtered)
    told = held_symmetries(() if each else job.twins, job.articulation, articulation)
    space = Space(motion_noise(job.config.motion, domain), domain, told)
    with_rates = job.config.motion.kind == "constant_velocity"
    found = smooth(filtered, space)[: job.count]
    told_of = (
        None if b is None else summarise_belief(stated_belief(b, domain), told, domain, with_rates) for b in found
    )
    return SmoothReport(tuple(None if e is None else smoothed_in_full_frame(e, camera) for e in told_of))


def with_rates(estimate: Estimate, state: FilterState, belief: Belief | None, domain: Domain) -> Estimate:
    """The estimate with the rates of its poses."""
    mean, best = (
        replace(pose, rotation_rate=rotation_rate(state, pose.quaternion)) for pose in (estimate.mean, estimate.best)
    )
    if belief is None:
        return replace(estimate, mean=mean, best=best)
    batch = Poses(best.quaternion[None], best.position[None], np.log([best.scale]), np.asarray(best.joints)[None])
    return replace(estimate, mean=mean, best=best, rates=rates_near(belief, batch, domain))
