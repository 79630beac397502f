"""Clusters of the posterior on the manifold of poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.inference.articulation import Articulation
from service.inference.pose import angle_between
from service.inference.state import Array, Poses

Labels = NDArray[np.intp]

CLUSTER_RADIUS_DEG = 15.0
JOINT_RADIUS_DEG = 30.0  # two joint values further apart than this are two answers
JOINT_RADIUS_SHARE = 0.15  # the same for a prismatic joint, of its range
MAX_CLUSTERS = 32


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
    """Label each pose by the cluster it belongs to, 0 for the one around the pose of highest priority.

    Greedy: the best pose not yet taken opens a cluster and takes all within one radius; each pose then joins the
    nearest opening pose. At most ``MAX_CLUSTERS``; what remains joins the nearest.
    """
    n = len(poses)
    nearest = np.full(n, np.inf)
    labels = np.zeros(n, dtype=np.intp)
    for k in range(MAX_CLUSTERS):
        open_ = nearest > 1.0
        if not np.any(open_):
            break
        seed = int(np.argmax(np.where(open_, priority, -np.inf)))
        gap = distance(poses, poses[seed : seed + 1], metric)
        closer = gap < nearest
        labels[closer] = k
        nearest[closer] = gap[closer]
    return labels
