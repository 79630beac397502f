"""A mesh that is not quite its body: by how much poses and their evidence are off (docs/model.md, section 5).

It pulls a pose the same way from frame to frame, and what it leaves in an image paint takes up: no frame tells it. So
poses are followed as if it were right, but what tells one from another counts for less, and spreads are told wider.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.inference.belief import Belief
from service.inference.domain import Domain
from service.inference.model import prior
from service.inference.state import Array, Mixture


def evidence_trust(domain: Domain) -> float:
    """Power of evidence from one mode to another: of lookalikes the wrong one may be more like a body that is off."""
    return prior.EVIDENCE_TRUST / (1 + (domain.prior.mesh_error / prior.MESH_DOUBT) ** 4)


def mesh_variance(log_scale: Array, domain: Domain) -> Array:
    """(K, 6 + J) by which a mesh that is off by ``prior.mesh_error`` widens K poses, in each axis' unit, squared.

    ``log_scale`` (K,). A hinge is off as the body is, a slide as the body's place.
    """
    error, joints = domain.prior.mesh_error, domain.articulation.joints
    place = prior.MESH_PLACE * error * domain.radius  # model units
    own = [np.rad2deg(prior.MESH_TURN * error) if joint.kind == "revolute" else place for joint in joints]
    each = [*(3 * [prior.MESH_TURN * error]), 0.0, 0.0, prior.MESH_GROWTH * error, *own]
    sigma = np.tile(np.array(each), (len(log_scale), 1))
    sigma[:, 3:5] = (place * np.exp(log_scale))[:, None]
    return np.asarray(sigma**2)


def stated(mixture: Mixture, domain: Domain) -> Mixture:
    """Modes with scales of their Student t's as they are told."""
    if domain.prior.mesh_error == 0:
        return mixture
    return replace(mixture, covariance=_wider(mixture.covariance, mesh_variance(mixture.poses.log_scale, domain)))


def stated_belief(belief: Belief, domain: Domain) -> Belief:
    """A belief with covariances as they are told: those of the same Student t's."""
    if domain.prior.mesh_error == 0:
        return belief
    variance = mesh_variance(belief.poses.log_scale, domain)
    variance *= prior.POSE_DEGREES_OF_FREEDOM / (prior.POSE_DEGREES_OF_FREEDOM - 2)
    return replace(belief, covariance=_wider(belief.covariance, variance))


def _wider(covariance: Array, variance: Array) -> Array:
    """(K, 2d, 2d) of poses and rates, the poses' (K, d) added; a rate is as it was, for the pull is slow."""
    wider, d = covariance.copy(), variance.shape[1]
    wider[:, range(d), range(d)] += variance
    return wider
