"""What is reported: the mean (Eq. 5), the spread about it, and the modes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from service.inference.domain import Domain
from service.inference.modes import cluster, metric_of
from service.inference.pose import (
    angle_between,
    conjugate,
    exp_so3,
    local,
    log_so3,
    multiply,
    yaw_pitch_roll_deg,
)
from service.inference.state import Array, Estimate, Mode, Outcome, PoseEstimate, Poses, Spread
from service.inference.weights import effective_sample_size, second_moment

LEFT_OUT = 0.01  # shown: modes that hold less than this share together are not listed
NEGLIGIBLE_NATS = 50.0  # numerical: ten million particles so much lighter than the heaviest change no digit of a sum


def mean_rotation(quaternion: Array, weights: Array) -> Array:
    """(4,) weighted mean on SO(3): minimises the weighted sum of squared geodesic angles (Karcher).

    Starts from the chordal mean (Markley et al. 2007), which is unique where the weights are not spread evenly.
    """
    mean = np.linalg.eigh(second_moment(weights, quaternion))[1][:, -1]
    for _ in range(10):
        step = weights @ log_so3(multiply(conjugate(mean), quaternion))
        mean = multiply(mean, exp_so3(step))
        if float(step @ step) < 1e-16:
            break
    return mean if mean[0] >= 0 else -mean


def mean_pose(poses: Poses, weights: Array, wrapping: NDArray[np.bool_]) -> Poses:
    """Eq. 5: the expected pose, as a batch of one. Rotations and full-turn joints are averaged on their circles."""
    joints = weights @ poses.joints
    if np.any(wrapping):
        angle = np.deg2rad(poses.joints)
        circular = np.rad2deg(np.arctan2(weights @ np.sin(angle), weights @ np.cos(angle)))
        joints = np.where(wrapping, circular, joints)
    return Poses(
        mean_rotation(poses.quaternion, weights)[None],
        (weights @ poses.position)[None],
        np.array([np.log(weights @ np.exp(poses.log_scale))]),
        joints[None],
    )


def tangent(origin: Poses, poses: Poses, wrapping: NDArray[np.bool_]) -> Array:
    """(N, 6 + J) tangent coordinates with joint differences of full-turn joints taken the short way round."""
    x = local(origin, poses)
    x[:, 6:] = short_way(x[:, 6:], wrapping)
    return x


def short_way(off: Array, wrapping: NDArray[np.bool_]) -> Array:
    """(N, J) differences of joints, of full-turn joints (``wrapping``) the short way round."""
    return np.asarray(np.where(wrapping, np.mod(off + 180.0, 360.0) - 180.0, off))


def spread(poses: Poses, weights: Array, mean: Poses, wrapping: NDArray[np.bool_]) -> Spread:
    """Weighted second moments about ``mean``."""
    x = tangent(mean, poses, wrapping)
    x[:, :3] = np.rad2deg(x[:, :3])
    covariance = second_moment(weights, x)
    turns = yaw_pitch_roll_deg(poses.quaternion) - yaw_pitch_roll_deg(mean.quaternion)
    turns = np.mod(turns + 180.0, 360.0) - 180.0
    euler = np.sqrt(weights @ turns**2)
    deviation = np.sqrt(np.diag(covariance))
    return Spread(
        orientation_deg=float(np.sqrt(np.trace(covariance[:3, :3]))),
        yaw_deg=float(euler[0]),
        pitch_deg=float(euler[1]),
        roll_deg=float(euler[2]),
        x_px=float(deviation[3]),
        y_px=float(deviation[4]),
        scale_px=float(np.sqrt(weights @ (np.exp(poses.log_scale) - np.exp(mean.log_scale)) ** 2)),
        joints=deviation[6:],
        covariance=covariance,
    )


def report(pose: Poses) -> PoseEstimate:
    """A batch of one, as a pose to show (w >= 0)."""
    q = pose.quaternion[0]
    return PoseEstimate(q if q[0] >= 0 else -q, pose.position[0], float(np.exp(pose.log_scale[0])), pose.joints[0])


def summarise(outcome: Outcome, log_background: float, domain: Domain) -> Estimate:
    """Everything that a frame's answer says of the posterior.

    ``log_background`` is the constant of Eq. 2, which every log likelihood of the frame shares.
    """
    counted = np.flatnonzero(outcome.log_weights > np.max(outcome.log_weights) - NEGLIGIBLE_NATS)
    weights, poses = np.exp(outcome.log_weights[counted]), outcome.poses[counted]
    mean = domain.wrap(mean_pose(poses, weights, domain.wrapping))
    top = int(np.argmax(outcome.log_likelihood))
    return Estimate(
        status=outcome.status,
        mean=report(mean),
        best=report(outcome.poses[top : top + 1]),
        best_log_likelihood=float(outcome.log_likelihood[top]) + log_background,
        spread=spread(poses, weights, mean, domain.wrapping),
        modes=find_modes(poses, weights, outcome.log_likelihood[counted], domain),
        n_particles=len(outcome.log_weights),
        ess=effective_sample_size(outcome.log_weights),
        log_evidence=outcome.log_evidence + log_background,
    )


def find_modes(poses: Poses, weights: Array, log_likelihood: Array, domain: Domain) -> tuple[Mode, ...]:
    """Clusters with their weight, mean and spread, heaviest first, until all but ``LEFT_OUT`` is told."""
    labels = cluster(poses, log_likelihood, metric_of(domain.articulation))
    share = np.bincount(labels, weights=weights)
    modes: list[Mode] = []
    for k in np.argsort(-share):
        members = np.flatnonzero(labels == k)
        if modes and sum(m.weight for m in modes) > 1 - LEFT_OUT:
            break
        inner = weights[members] / share[k]
        mean = domain.wrap(mean_pose(poses[members], inner, domain.wrapping))
        width = spread(poses[members], inner, mean, domain.wrapping)
        modes.append(Mode(float(share[k]), report(mean), width))
    return tuple(modes)


def twin_modes(everybody: Sequence[Poses], weights: Array, share: float, domain: Domain) -> list[Mode]:
    """One mode of weight ``share`` as it is told: once per twin, less those that lie within its own spread.

    ``everybody`` lists its particles and each set of their twins; ``weights`` (N,) sum to 1.
    """
    found: list[tuple[Poses, Spread, float]] = []
    for poses in everybody:
        mean = domain.wrap(mean_pose(poses, weights, domain.wrapping))
        width = spread(poses, weights, mean, domain.wrapping)
        for i, (other, _, weight) in enumerate(found):
            apart = np.rad2deg(float(angle_between(mean.quaternion, other.quaternion)[0]))
            joints_agree = np.all(np.abs(tangent(other, mean, domain.wrapping)[0, 6:]) <= 2 * width.joints + 1e-9)
            if apart < max(1e-6, 2 * width.orientation_deg) and joints_agree:
                found[i] = (other, found[i][1], weight + share / len(everybody))
                break
        else:
            found.append((mean, width, share / len(everybody)))
    return [Mode(weight, report(mean), width) for mean, width, weight in found]
