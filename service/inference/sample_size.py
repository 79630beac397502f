"""How many particles the next frame needs, told by the posterior after the last."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.inference.domain import Domain
from service.inference.modes import cluster, metric_of, short_way
from service.inference.params import SessionConfig
from service.inference.pose import local
from service.inference.state import Array, FilterState
from service.inference.weights import effective_sample_size

KLD_NATS = 0.05  # how far the particles may be from the posterior
KLD_QUANTILE = 2.326  # of the standard normal: in 99 of 100 draws
BIN_DEG = 2.0
BIN_SHARE = 0.01  # of the image's shorter side for positions, of its range for a prismatic joint
BIN_LOG_SCALE = 0.02
BIN_JOINT_DEG = 4.0
COUNTED = 1e-4  # of the heaviest weight: lighter particles hold nothing


def adapted(config: SessionConfig, state: FilterState | None, domain: Domain) -> SessionConfig:
    """``config`` with as many particles as the frame after ``state`` needs; all of them where nothing is tracked."""
    chosen = config.filter
    if chosen.adaptive == "off" or state is None or state.status != "tracking":
        return config
    wanted = kld_size(occupied_bins(state, domain)) if chosen.adaptive == "kld" else ess_size(state, chosen.enough_ess)
    count = min(max(wanted, chosen.least_particles), chosen.particles)
    return replace(config, filter=replace(chosen, particles=count))


def kld_size(bins: int) -> int:
    """Particles for which the KL divergence from a posterior spread over ``bins`` bins stays within ``KLD_NATS``.

    Fox, *KLD-sampling: adaptive particle filters* (2001), Eq. 5, by the Wilson-Hilferty transform of chi-square.
    """
    if bins < 2:
        return 1
    k = bins - 1
    part = 2.0 / (9.0 * k)
    return int(np.ceil(k / (2.0 * KLD_NATS) * (1.0 - part + np.sqrt(part) * KLD_QUANTILE) ** 3))


def ess_size(state: FilterState, enough: float) -> int:
    """Particles of which ``enough`` would have been effective, had the last frame's weights been as uneven."""
    share = effective_sample_size(state.log_weights) / len(state.log_weights)
    return int(np.ceil(enough / share))


def occupied_bins(state: FilterState, domain: Domain) -> int:
    """Bins of the pose space that hold particles of weight, counted in the tangent space of each mode's best."""
    counted = np.flatnonzero(state.log_weights > state.log_weights.max() + np.log(COUNTED))
    poses, log_weights = state.poses[counted], state.log_weights[counted]
    metric = metric_of(domain.articulation)
    labels = cluster(poses, log_weights, metric)
    total = 0
    for label in np.unique(labels):
        members = np.flatnonzero(labels == label)
        top = members[int(np.argmax(log_weights[members]))]
        x = short_way(local(poses[top : top + 1], poses[members]), metric)
        total += len(np.unique(np.floor(x / _bin(domain)).astype(np.int64), axis=0))
    return total


def _bin(domain: Domain) -> Array:
    """(6 + J,) size of a bin."""
    side = BIN_SHARE * min(domain.width, domain.height)
    turn = np.deg2rad(BIN_DEG)
    least, greatest = domain.joint_bounds
    revolute = [joint.kind == "revolute" for joint in domain.articulation.joints]
    joints = np.where(revolute, BIN_JOINT_DEG, BIN_SHARE * (greatest - least))
    return np.array([turn, turn, turn, side, side, BIN_LOG_SCALE, *joints])
