"""The whole space searched: starts placed on the evidence, the most promising refined on their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.inference.acquisition import Evidence, place
from service.inference.domain import Domain
from service.inference.islands import Islands, refine, scatter, strongest
from service.inference.proposal import Component
from service.inference.state import Array, Poses
from service.inference.symmetry import fold
from service.inference.update import Update

STAGES = ((64, 6, 24), (20, 6, 40), (8, 7, 50))  # islands, rounds, draws per round
GLANCE = ((20, 4, 24), (8, 4, 40), (4, 5, 50))  # the same beside an established track
GLANCE_SHARE = 0.25  # of the starts
IN_PLAY_NATS = 6.0  # a basin whose peak lies further below the best, after the exponent, gets no particles


def search_islands(update: Update, evidence: Evidence, anchor: Poses | None = None, glance: bool = False) -> Islands:
    """The basins whose peaks the frame's likelihood leaves in play, best first.

    Of each set of twins the one nearest to ``anchor`` (one pose), or to the best island. A ``glance`` looks at fewer
    starts, and at light and shade of its last islands only: the track may stand, and the frame must not wait.
    """
    domain, metric = update.domain, update.metric
    starts, stages = update.config.filter.acquisition_particles, STAGES
    if glance:
        starts, stages = max(1, round(GLANCE_SHARE * starts)), GLANCE
    poses = place(update.rng, domain, evidence, update.score_maps, starts)
    islands = scatter(poses, update.score(poses), metric, stages[0][0], search_reach(domain))
    for stage, (count, rounds, draws) in enumerate(stages):
        if stage > 0 and not glance:  # before, they are too far from their peaks, and too many
            islands = shaded(update, strongest(islands, metric, 3 * count // 2))
        islands = strongest(islands, metric, count)
        islands = refine(update.rng, islands, update.score, domain.contains, rounds, draws)
    islands = shaded(update, islands)
    top = int(np.argmax(islands.rank))
    near = islands.best[top : top + 1] if anchor is None else anchor
    folded, _ = fold(islands.best, np.zeros((len(islands), domain.n_tangent)), update.twins, domain, near)
    islands = strongest(replace(islands, best=folded), metric, len(islands))
    exponent = update.config.likelihood.mode_exponent
    in_play = exponent * (islands.rank - islands.rank.max()) > -IN_PLAY_NATS
    return islands[np.flatnonzero(in_play)]


def shaded(update: Update, islands: Islands) -> Islands:
    """The islands with what light and shade say of their best poses."""
    return replace(islands, shading=update.shading(islands.best))


def search_reach(domain: Domain) -> Array:
    """(6 + J,) standard deviation with which an island starts: about the distance between placed starts."""
    least, greatest = domain.joint_bounds
    side = 0.012 * min(domain.width, domain.height)
    return np.array([0.12, 0.12, 0.12, side, side, 0.08, *(0.06 * (greatest - least))])


def island_components(
    update: Update, islands: Islands, log_weight: float, beside: float | None = None
) -> list[Component]:
    """Each island as a mode that may be anywhere within the search's reach, with rates of which nothing is known.

    ``beside``: the shading of the track that they stand beside, in nats; without one it is that of the best of them.
    """
    d = update.domain.n_tangent
    reach = np.diag(search_reach(update.domain) ** 2)
    rates = np.diag(np.sqrt(update.rates.variance))
    share = log_weight - float(np.log(len(islands)))
    alone = [islands.best[np.array([k])] for k in range(len(islands))]
    gain = islands.shading - (np.max(islands.shading) if beside is None else beside)
    shares = share + update.config.likelihood.mode_exponent * gain
    pairs = zip(shares.tolist(), alone, strict=True)
    return [Component(share, best, reach, np.zeros(d), np.zeros((d, d)), rates) for share, best in pairs]


def log_occam(update: Update, n_islands: int) -> float:
    """What the evidence of ``island_components`` is too large by, as a log: add it before models are compared.

    Each of the islands was given a prior around the peak that the frame itself showed. The prior that knew nothing is
    uniform over the whole space, where an island has the share (2 pi)^(d/2) prod(reach) / volume; it counts in full
    beside the other islands, and once for every twin. A joint more is a dimension more: without this a model with
    joints would be favoured.
    """
    reach = search_reach(update.domain)
    share = 0.5 * len(reach) * np.log(2 * np.pi) + np.sum(np.log(reach)) - update.domain.log_volume
    return float(share + np.log(n_islands * (len(update.twins) + 1)))
