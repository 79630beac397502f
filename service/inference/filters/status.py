"""What a mixture says of itself: probabilities as they are told, and the status that is read off them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from service.inference.domain import Domain
from service.inference.model import existence
from service.inference.pose import concatenate
from service.inference.revolution import angle_apart
from service.inference.state import Array, Mixture, Poses
from service.inference.symmetry import Symmetry, twin

SURE = 0.9  # contract: probability from which on an answer is told as one
_NOTHING = 1e-300  # numerical: divides nothing by nothing
_EQUIVALENT_DEG = 5.0  # contract: modes whose rotations are nearer are one answer


def told_existence(mixture: Mixture, mesh_error: float = 0.0) -> Array:
    """(3,) probabilities: what no search may have met is nothing that the modes explain, nor is another body, nor what
    a cloud makes of one; it is something as probably as the frame shows anything at all. ``mesh_error``:
    ``PriorParams``.
    """
    absent, fits, no_fit = mixture.existence
    kept = fits * found_share(mixture, mesh_error)
    empty = (fits - kept) * absent / max(absent + no_fit, _NOTHING)
    return np.array([absent + empty, kept, no_fit + fits - kept - empty])


def found_share(mixture: Mixture, mesh_error: float = 0.0) -> float:
    """Probability that what leads is this body at its pose, whatever may be between just now."""
    displaced = 0.0 if mixture.displaced is None else mixture.displaced.probability
    return followed_share(mixture, mesh_error) * (1 - displaced)


def followed_share(mixture: Mixture, mesh_error: float = 0.0) -> float:
    """Probability that it is this body whose light was followed, though something else may have its place now."""
    met = 1 - existence.missed(mixture.searches, mixture.misses, nats=mixture.searched_nats)
    told = mixture.log_discrepancy
    if told is None:
        told = existence.log_discrepancy_known(mixture.discrepancy)
    return float(met * existence.of_this_body(told, mesh_error))


def status_of(mixture: Mixture, twins: Sequence[Symmetry], domain: Domain) -> str:
    """One of ``state.STATUSES``, read off the probabilities."""
    absent, fits, _ = told_existence(mixture, domain.prior.mesh_error)
    if absent >= SURE:
        return "no_target"
    if fits < 0.5:
        return "lost" if mixture.ever_tracked else "no_fit"
    if fits >= SURE and leading_share(mixture, twins, domain) >= SURE:
        return "tracking"
    return "ambiguous" if fits >= SURE or mixture.ever_tracked else "acquiring"


def leading_share(mixture: Mixture, twins: Sequence[Symmetry], domain: Domain) -> float:
    """Probability of the heaviest mode and of its symmetry-equivalents."""
    lead = int(np.argmax(mixture.log_weights))
    same = one_answer(mixture.poses[lead : lead + 1], mixture.poses, twins, domain)
    same[lead] = True
    return float(np.exp(mixture.log_weights[same]).sum())


def equivalents(pose: Poses, twins: Sequence[Symmetry], domain: Domain) -> Poses:
    """A pose (a batch of one), and those that cannot be told from it."""
    return concatenate(pose, *(domain.wrap(twin(pose, one)) for one in twins if one.kind == "rotation"))


def one_answer(pose: Poses, others: Poses, twins: Sequence[Symmetry], domain: Domain) -> NDArray[np.bool_]:
    """(N,) which of N poses turn the body as a batch of one does, or as one that cannot be told from it."""
    alike = equivalents(pose, twins, domain).quaternion
    axes = domain.articulation.round_axes
    apart = np.rad2deg(angle_apart(others.quaternion[:, None], alike[None], axes).min(axis=1))
    return np.asarray(apart < _EQUIVALENT_DEG)
