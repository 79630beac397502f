"""The priors of docs/model.md, section 1, each with its unit."""

from __future__ import annotations

from dataclasses import dataclass

ALBEDO_SIGMA = 0.9  # of log albedo about the frame's gain
EVEN_MEAN, EVEN_SIGMA = 0.04, 0.04  # even light, share of the gain
GLOSS_SHARE, GLOSS_LOG_SIGMA = 0.15, 1.3  # of a group's gloss, share of the gain
GLOSS_LOBES = (20.0,)  # exponent of (n . h): brushed metal
HIDDEN_MEAN, HIDDEN_SIGMA = 0.3, 0.4  # share of the sky's light that the body hides
SKY_SIGMAS = 2.0  # level and slopes that are left over, in noise of a pixel of empty sky
HERMITE_SIGMA = 0.15  # Gauss-Hermite deviations of the point spread
SHIFT_SHARE = 0.3  # image shifts in turbulence, as a share of w
CORE_PX, CORE_LOG_SIGMA = 1.2, 0.6  # s, frame px
WINGS_SIGMA_PX = 1.5  # w, frame px
DISCREPANCY, DISCREPANCY_LOG_SIGMA = 0.04, 0.35  # tau
DISCREPANCY_LENGTH = 17.0  # patch px over which the discrepancy is alike
DISCREPANCY_LEAST = 18.0  # pixels' areas over which it is alike, at the least
EDGE_PX = 2.0  # discrepancy of places: mesh and mean pose are so far from right, in units of tau
LOW_PASS_SHARE = 0.7  # the frame's own low pass, as a share of the point spread's width
DEGREES_OF_FREEDOM = 4.0  # of the Student t of a pixel
GAIN_SIGMA = 2.0  # of log gain about what the frame's light suggests: as good as flat


@dataclass(frozen=True)
class LightPrior:
    """What is told of the even light: its share of the Sun's."""

    even_mean: float = EVEN_MEAN
    even_sigma: float = EVEN_SIGMA
