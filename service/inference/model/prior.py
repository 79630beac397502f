"""The priors of docs/model.md, section 1, each with its unit."""

from __future__ import annotations

from dataclasses import dataclass

ALBEDO_SIGMA = 0.9  # of log albedo about the frame's gain
FACET_SIGMA = 0.15  # of log albedo of a facet about its piece's: of 0, 0.15 and 0.3 what is likeliest at the truth of
# 52 frames of 26 path-traced passes
EVEN_MEAN, EVEN_SIGMA = 0.04, 0.04  # even light, share of the gain
EVEN_TILT_SIGMA = 0.02  # by each part of the normal, share of the frame's brighter light: half of the Earth's 2 to 12 %
# goes with the normal, and the brighter light is of paint brighter than most
GLOSS_SHARE, GLOSS_LOG_SIGMA = 0.15, 1.3  # of a piece's gloss, share of the gain
GLOSS_LOBES = (20.0,)  # exponent of (n . h): brushed metal
EARTH_UNSURE = 0.5  # of the Earth's light, where it is told: clouds halve or double it
HIDDEN_MEAN, HIDDEN_SIGMA = 0.3, 0.4  # share of the sky's light that the body hides
HIDDEN_ALIKE = 0.01  # about that of a frame, which all poses share
SKY_SIGMAS = 2.0  # level and slopes that are left over, in noise of a pixel of empty sky
HERMITE_SIGMA = 0.15  # Gauss-Hermite deviations of the point spread
SHIFT_SHARE = 0.3  # image shifts in turbulence, as a share of w
CORE_PX, CORE_LOG_SIGMA = 1.2, 0.6  # s, frame px
WINGS_SIGMA_PX = 1.5  # w, frame px
SHARPENED_NATS = 6.0  # against an unsharp mask of some amount and width: one sequence in ten, 40 of them alike
DISCREPANCY, DISCREPANCY_LOG_SIGMA = 0.02, 0.7  # tau, before a body is known
DISCREPANCY_LENGTH = 17.0  # px of a patch as fine as is wanted over which the discrepancy is alike: a share of the body
PHOTON_SHARE, PHOTON_LOG_SIGMA = 0.7, 0.7  # variance per count, of what a frame's checkerboard has, and its log: edges
# leak into it (of 52 frames of 26 passes against the differences of two frames: -0.4 +- 0.6)
PHOTON_UNSURE = 1.5  # a factor within which the transfer is known once a body is seen
EDGE_PX = 2.0  # discrepancy of places: mesh and mean pose are so far from right, in units of tau
POSE_DEGREES_OF_FREEDOM = 4.0  # of a pose: c tau^2 is known to a factor of two, a variance so known gives a Student t
CHI2_DEGREES_OF_FREEDOM = 4.0  # that a frame's mean square of what is left over adds: it is alike all over a body
MESH_DISCREPANCY = 0.17  # tau of a body's own mesh, per unit of its relative error: of 39 passes
MESH_DOUBT = 0.026  # relative error of a mesh at which evidence between modes is worth half: its nats go with the
# error's square, what one is worth with one over their variance; of 168 frames 0.04 at 0.05, of 84 as ever at 0.02
MESH_TURN, MESH_PLACE, MESH_GROWTH = 0.33, 0.12, 0.3  # rad, share of the radius, log scale: the best pose is off by so
# much per unit of a mesh's relative error: of 38 passes of 14 bodies whose pieces are off by 5 %
LOW_PASS_SHARE = 0.5  # the frame's own low pass, as a share of the point spread's width: what is finer is speckle of
# the air that has no place in K: 0.35 decides no more turbulent passes, and takes more wrong meshes for right
DEGREES_OF_FREEDOM = 4.0  # of the Student t of a pixel
EXISTENCE = (0.1, 0.8, 0.1)  # absent, fits, no_fit, before anything is known
CHANGES_PER_S = 0.05  # of existence, per second
LOG_CHI2 = (0.1, 1.0)  # mean, sigma from body to body of the level of log chi2
LOG_CHI2_JITTER, LOG_CHI2_DRIFT = 0.35, 0.1  # from frame to frame of one body about its level, and of that level
LOG_CHI2_FREEDOM = 4.0  # of the Student t of that scatter: some frames leave over far more than others
LOG_CHI2_DISTURBED = (2.0, 1.5)  # above its level, when a cloud or a mirror changes what is seen of a body
DISCREPANCY_OWN, DISCREPANCY_OWN_LOG_SIGMA = 0.005, 0.7  # tau under a body's own mesh: its least, or above it
DISCREPANCY_UNLIKE = 0.06, 0.6  # of another's light that a mesh seems to fit: log-normal, median and log sigma, of 86
# passes followed with another mesh, 17 to 200 px
UNLIKE = 0.3  # tau of light that another body throws
SEARCH_WEIGHT = 2.5  # searches that what is known of the share of them that meet the truth is worth, from body to body
SEARCH_HALF = 170.0  # nats of a body against the empty sky with which half of them do: of 162 frames looked at alone,
# of 54 passes, 0 of 8 with less than 130 nats, 0.73 of 26 up to 530, 0.99 of 128 above
HIDDEN_MISSED = 0.5  # of the share of a body's light that is hidden: so many searches miss it for that; of the first
# frames of 26 passes 25 are right, 24 where the frame's edge cuts 0.15 of the body off, 22 where 0.3, 22 where 0.4: 0.3
# of it; but of an answer that ends at the edge wrongly less is hidden than of the truth
EVIDENCE_TRUST = 0.15  # power of evidence from one mode to another: the truth loses by up to 14 nats in single frames;
# of 364 frames those told with a share of 0.9 or more are right, all 318; between 0.7 and 0.9 it is 0.5, below 0.5 0.36
ANSWER_WRONG = 0.003  # probability that an answer is wrong that is told with 1: one of 320, after 318 that are right
TELESCOPE_MOVED = 0.02  # probability, per frame: the body may then be anywhere in it
FADES = 0.5  # log of the light's change from one frame to the next: turning panels, glints
MEMORY_KEPT = 0.4  # of what earlier frames say of a pose: they err where the next one errs
SUN_DRIFT = 0.02  # rad, per root s, in camera axes: the field turns while a telescope follows a pass
PAINT_DRIFT = 0.01  # of log albedo, per frame: estimates of it change by 0.04, nearly all of that their own noise
PAINT_TURN = 3.0  # of log albedo and gloss, per squared rad that a body turns from frame to frame: other facets show,
# and other sides of lobes, which are flat at their middle; by the evidence of four passes at 4 to 19 deg a frame
PAINT_DOUBTED = 0.9  # of what is known of paint stays in a frame that more likely is not of it
EVIDENCE_KEPT = 0.7  # of what earlier frames say of one mode against another, likewise
BIRTH = 0.1  # probability that the truth is not among the modes when a search is made
NEW_MODE = 0.01  # probability that a mode was not among those of the frame before: a birth, and one frame in ten
STAR = 14.0  # nats against a star there: one in 8,000 px; its place told to 0.1 px, its light to a tenth of 3 e-folds
GAIN_SIGMA = 2.0  # of log gain about what the frame's light suggests: as good as flat
CLUTTER_ALIKE_PX = 16.0  # frame px over which colours before clutter are alike: so many, squared, count as one
OUTLINE_FREEDOM = 0.15  # nats that an outline of its own choice pays for each such length of its rim: under right
# meshes it would gain up to 0.08 (nine sequences), under wrong ones 0.1 to 0.5 (five)
COLOURS_KEPT = 0.9  # of what is known of a body's and a clutter's colours, from frame to frame
ANOTHER_OF_ITS_SHAPE = 0.15  # probability that what fits an outline before clutter is another body of this shape
RIM_UNSEEN = 0.2  # share of a rim before clutter across which brightness does not change
RIM_ALIKE_PX = 8.0  # frame px along a rim over which the slopes across it are alike


Around = tuple[float, float, float, float]


@dataclass(frozen=True)
class LightPrior:
    """What is told of the light that is not the Sun's, as shares of it.

    ``around``: of the Earth, where it is known: a face of normal n has max(0, around[:3] . n + around[3]) of it, as it
    is painted; even light is then what is left over.
    """

    even_mean: float = EVEN_MEAN
    even_sigma: float = EVEN_SIGMA
    around: Around = (0.0, 0.0, 0.0, 0.0)

    @property
    def whole(self) -> Around:
        """The same with the even light that is expected, as if of white faces: what templates are drawn in."""
        x, y, z, alike = self.around
        return x, y, z, alike + self.even_mean


def earthlight(direction: tuple[float, float, float], strength: float, aside: float) -> LightPrior:
    """The Earth's light, told: unit vector towards it, light of a face that faces it, and of that what others have."""
    x, y, z = (strength * (1 - aside) * part for part in direction)
    return LightPrior(0.0, EARTH_UNSURE * strength, (x, y, z, strength * aside))
