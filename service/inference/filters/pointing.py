"""A telescope that was moved: the body is as it was expected, but elsewhere in the frame (docs/model.md, section 5)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from service.inference.filters.given import Given, Predicted
from service.inference.model import prior
from service.inference.model.expected import lit_box
from service.inference.model.stages import Sight
from service.inference.state import Array, Mixture

_ASIDE = 0.25  # numerical: of the body's radius: light no further from its place is asked no more
_NEAR = 0.5  # numerical: of the radius: light that its motion may bring so far placing finds
_AGREE = 0.08  # numerical: of the radius: middles of light that is seen and of light that is expected agree so well


def pointed(ahead: Predicted, before: Mixture, given: Given) -> tuple[Predicted, ...]:
    """The modes as they are expected, and where the frame shows their light if that is elsewhere; the likelier first.

    The telescope was moved, if light lies where the leader's own motion does not bring it, sooner than anywhere in the
    frame by chance. While something shows where the body should be, light elsewhere rather is another's.
    """
    lead = int(np.argmax(ahead.log_weights))
    place, body = ahead.poses.position[lead], given.body.fine
    sight = given.frame.around(place, np.inf, before.span_px, float(before.point_spread[0]))
    radius = body.radius * float(np.exp(ahead.poses.log_scale[lead]))
    if float(np.hypot(*(sight.centre - place))) <= _ASIDE * radius:
        return (ahead,)
    leader = ahead.poses[lead : lead + 1], ahead.suns[lead : lead + 1], ahead.paint[lead]
    box = lit_box(body, *leader, lens=sight.lens)
    if box is None:
        return (ahead,)
    off = np.asarray(sight.centre) - 0.5 * (box[:2] + box[2:])
    loose = _AGREE * radius + 0.5 * abs(float(np.max(box[2:] - box[:2])) - sight.span)  # it may be any part of it
    variance = 0.5 * float(np.trace(ahead.covariance[lead][3:5, 3:5])) + loose**2
    stayed = -0.5 * float(off @ off) / variance - float(np.log(2 * np.pi * variance))
    moved = np.log(prior.TELESCOPE_MOVED) - np.log(given.domain.width * given.domain.height)
    there = replace(ahead, aside=off)
    if stayed < moved:
        covariance = ahead.covariance.copy()
        size = np.array([given.domain.width, given.domain.height])
        covariance[:, [3, 4], [3, 4]] += size**2 / 12  # of a uniform law
        there = replace(there, covariance=covariance)
    elif float(np.hypot(*off)) <= max(_NEAR * radius, loose):
        return (ahead,)
    return (ahead, there) if _shows_there(sight, box) else (there, ahead)


def _shows_there(sight: Sight, box: Array) -> bool:
    """Whether light shows in the box where the body's is expected, that is not part of the frame's brightest."""
    low, high = np.subtract(sight.centre, 0.5 * sight.span), np.add(sight.centre, 0.5 * sight.span)
    if np.all((low < box[2:]) & (high > box[:2])):
        return False
    middles: NDArray[np.float64] = 0.5 * (sight.pieces[:, :2] + sight.pieces[:, 2:])
    return bool(np.any(np.all((middles >= box[:2]) & (middles <= box[2:]), axis=1)))
