"""Clusters of the posterior on the manifold of poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.inference.articulation import Articulation
from service.inference.pose import angle_between
from service.inference.state import Array, Poses

Labels = NDArray[np.intp]

CLUSTER_RADIUS_DEG = 15.0  # shown: particles nearer than this are of one answer
JOINT_RADIUS_DEG = 30.0  # shown: two joint values further apart than this are two answers
JOINT_RADIUS_SHARE = 0.15  # shown: the same for a prismatic joint, of its range
MAX_CLUSTERS = 32  # numerical: that are opened
MOST_MODES = 8  # numerical: that are followed from frame to frame, and kept for the smoother
LEAST_MODE = 1e-4  # numerical: a mode that holds less is neither


@dataclass(frozen=True)
class Metric:
    """How far two joint values of one mode may be apart, and after what they repeat."""

    joint_radius: Array  # (J,) degrees or model units
    joint_turn: Array  # (J,) 360 for joints that turn all the way round, else infinite


def metric_of(articulation: Articulation) -> Metric:
    """The metric of a model's joints."""
    radius, turn = [], []
    for joint in articulation.joints:
        span = joint.maximum - joint.minimum
        revolute = joint.kind == "revolute"
        radius.append(JOINT_RADIUS_DEG if revolute else JOINT_RADIUS_SHARE * span)
        turn.append(360.0 if revolute and span >= 360 else np.inf)
    return Metric(np.array(radius), np.array(turn))


def distance(poses: Poses, seed: Poses, metric: Metric) -> Array:
    """(N,) distance of poses from one pose, in cluster radii: rotation and joints, the slow directions."""
    angle = np.rad2deg(angle_between(poses.quaternion, seed.quaternion)) / CLUSTER_RADIUS_DEG
    if poses.joints.shape[1] == 0:
        return angle
    gap = np.abs(poses.joints - seed.joints)
    gap = np.minimum(gap, np.abs(metric.joint_turn - gap))
    return np.asarray(np.maximum(angle, np.max(gap / metric.joint_radius, axis=1)))


def cluster(poses: Poses, priority: Array, metric: Metric) -> Labels:
    """(N,) label of each pose's cluster, 0 for the one around the pose of highest priority (see ``find_seeds``)."""
    return nearest_seed(poses, find_seeds(poses, priority, metric), metric)


def find_seeds(poses: Poses, priority: Array, metric: Metric) -> Poses:
    """The poses that clusters form around.

    Greedy: the best pose not yet taken opens a cluster and takes all within one radius, at most ``MAX_CLUSTERS``
    times. Each pose belongs to its nearest seed.
    """
    nearest = np.full(len(poses), np.inf)
    seeds: list[int] = []
    while len(seeds) < MAX_CLUSTERS and np.any(nearest > 1.0):
        seeds.append(int(np.argmax(np.where(nearest > 1.0, priority, -np.inf))))
        nearest = np.minimum(nearest, distance(poses, poses[seeds[-1] : seeds[-1] + 1], metric))
    return poses[np.array(seeds, dtype=np.intp)]


def nearest_seed(poses: Poses, seeds: Poses, metric: Metric) -> Labels:
    """(N,) index of the seed that each pose is nearest to."""
    if len(seeds) == 1:
        return np.zeros(len(poses), dtype=np.intp)
    gaps = np.stack([distance(poses, seeds[k : k + 1], metric) for k in range(len(seeds))])
    return np.asarray(np.argmin(gaps, axis=0), dtype=np.intp)
