"""What the filter carries from frame to frame, and the glossary of symbols used in this package.

=========== =========================================== =====================================================
symbol      name here                                   meaning
=========== =========================================== =====================================================
theta       ``Poses``                                   one pose per particle: rotation, position, scale, joints
R           ``quaternion``                              rotation body -> camera
p           ``log_weights``                             log of the normalised particle weights
D           image                                       the frame
p(D|b)      background                                  distribution of a pixel that shows empty sky
p(D|f)      foreground                                  distribution of a pixel that shows the object
log c       ``log_ratio``                               log p(D|f) - log p(D|b), per pixel (Eq. 3)
f(theta)    silhouette                                  pixels whose centre the projected object covers
N, P, J     n_particles, n_parts, n_joints              sizes of the arrays
d           ``6 + J``                                   tangent coordinates (rx, ry, rz, x, y, log scale, joints)
=========== =========================================== =====================================================

Equations are those of Bazik, Flewelling, Majji, Mundy, *Bayesian Inference of Spacecraft Pose Using
Particle Filtering*, AMOS 2018 (arXiv 1906.11182).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STATUSES = ("acquiring", "tracking", "ambiguous", "no_fit", "lost", "no_target")


@dataclass(frozen=True)
class Poses:
    """A batch of N poses (weak perspective, the paper's affine camera).

    A body point X lands at ``exp(log_scale) * (R X)_xy + position`` in pixels; pixel (0, 0)'s outer corner
    is the origin.
    """

    quaternion: Array  # (N, 4) w, x, y, z; unit; body -> camera
    position: Array  # (N, 2) px
    log_scale: Array  # (N,) log of pixels per model unit
    joints: Array  # (N, J) degrees (revolute) or model units (prismatic)

    def __len__(self) -> int:
        return len(self.log_scale)

    def __getitem__(self, index: slice | NDArray[np.integer] | NDArray[np.bool_]) -> Poses:
        return Poses(self.quaternion[index], self.position[index], self.log_scale[index], self.joints[index])


@dataclass(frozen=True)
class Displaced:
    """An answer in whose place another leads, that no mode was near."""

    probability: float  # that it is right, and that something has come between
    pose: Poses  # (1) as it is expected
    rates: Array  # (1, d)
    was: Mixture | None = None  # what was known of it, its mode alone; None: as versions before did not keep it
    since_s: float = 0.0  # since the first frame that it does not explain


@dataclass(frozen=True)
class Mixture:
    """The posterior of ``filters.mixture``: K modes over pose and rates, and what the frames share; d = 6 + J.

    A mode is a Student t about its pose (``model.prior.POSE_DEGREES_OF_FREEDOM``), its rates tangent velocities per
    second.
    """

    poses: Poses  # (K)
    rates: Array  # (K, d)
    covariance: Array  # (K, 2d, 2d) scale of (pose in the tangent space, rates)
    suns: Array  # (K, 3) towards the Sun, unit
    sun_sigmas: Array  # (K,) rad, each axis across it
    paint: Array  # (K, 2, P) what each has learnt of the surfaces: see ``model.paint``
    log_weights: Array  # (K,) of probabilities given that the model fits
    existence: Array  # (3,) probabilities: absent, fits, no_fit
    point_spread: Array  # (2,) s and w, frame px
    discrepancy: float  # tau
    log_chi2: Array  # (2,) mean and variance of the log of what the body leaves over
    log_light: float  # of the body's whole light, counts, as it was when it last fitted; then slowly doubted
    span_px: float  # of the patch, frame px
    ever_tracked: bool
    searches: int  # that could not better the leader, one after the other
    misses: int  # that had not found it while another led
    since_search: int  # frames since the last of a search
    photon: float | None = None  # variance per count of light; None: as each frame suggests
    hides: float | None = None  # counts of the sky's light that the body hides; None: as likely as its prior has it
    sharpened: float = 0.0  # amount of an unsharp mask that the frames have been through
    mask: float = 0.0  # its width, frame px
    searched_nats: float = 340.0  # log evidence against the empty sky where it was searched; as if 0.8 of them met it
    parts_searched: int = 0  # of the search that is under way
    answered: float = 0.0  # probability that the leading answer was told with when it last fitted
    displaced: Displaced | None = None  # by the leader
    log_discrepancy: Array | None = None  # (2,) pull and information of it that frames have; None: that of tau


@dataclass(frozen=True)
class Clutter:
    """What is known of a body before clutter beside its modes: colours (``imaging.clutter.Palette``), and a picture."""

    body: NDArray[np.float32]  # (B,) log density of its colours
    clutter: NDArray[np.float32]  # (B,) of what lies about it
    low: float  # counts that are 0 of 256 grey levels
    span: float  # counts of all of them
    picture: NDArray[np.uint8]  # (S, S) the square about the body as it was seen last
    corner: Array  # (2,) its first corner, frame px


@dataclass(frozen=True)
class FilterState:
    """The weighted posterior after a frame; it can be written to a file and read back bit for bit."""

    poses: Poses
    log_weights: Array  # (N,) log of weights that sum to 1
    rates: Array  # (N, 6 + J) tangent velocity per second; (0, 6 + J) where they are only looked at
    frame_index: int  # of the frame this posterior belongs to
    time_s: float  # of that frame
    status: str  # one of STATUSES
    memory: Mapping[str, NDArray[np.generic]] = field(default_factory=dict)  # of versions before 2: read, not used
    mixture: Mixture | None = None  # of the method that keeps modes
    clutter: Clutter | None = None  # of a body before clutter

    def to_show(self) -> FilterState:
        """Where modes are carried on, particles are looked at alone: 32-bit floats, and no rates.

        Rounded, a quaternion is off by 1e-7 rad, a place at 4,000 px by 2e-4 px. Scale and joints stay as they are:
        they have bounds that rounding must not pass.
        """
        parts = self.poses.quaternion, self.poses.position, self.log_weights
        quaternion, position, log_weights = (cast(Array, np.asarray(part, np.float32)) for part in parts)
        poses = replace(self.poses, quaternion=quaternion, position=position)
        return replace(self, poses=poses, log_weights=log_weights, rates=self.rates[:0])


@dataclass(frozen=True)
class Measurement:
    """What one frame says (log of Eq. 2 and Eq. 3)."""

    log_ratio: NDArray[np.float32]  # (H, W) log p(D|f) - log p(D|b) per pixel
    log_background: float  # sum over the image of log p(D|b) - log p(D)


@dataclass(frozen=True)
class Frame:
    """One frame as the filter sees it."""

    index: int
    time_s: float
    measurement: Measurement


@dataclass(frozen=True)
class Outcome:
    """The posterior after a frame, before it is summarised."""

    poses: Poses
    log_weights: Array  # (N,)
    log_likelihood: Array  # (N,) particle term of Eq. 4
    rates: Array  # (N, 6 + J)
    status: str
    log_evidence: float


@dataclass(frozen=True)
class PoseEstimate:
    """One pose to report."""

    quaternion: Array  # (4,)
    position: Array  # (2,) px
    scale: float  # px per model unit
    joints: Array  # (J,)
    rotation_rate: Array | None = None  # (3,) rad/s against the camera, in body axes; None: unknown


@dataclass(frozen=True)
class Spread:
    """Weighted standard deviations and the covariance about a mean pose.

    ``covariance`` is (6 + J, 6 + J) in the order rx, ry, rz (degrees, body-side rotation vector), x, y (px),
    log scale, joints. ``orientation_deg`` is the weighted RMS geodesic angle.
    """

    orientation_deg: float
    yaw_deg: float
    pitch_deg: float
    roll_deg: float
    x_px: float
    y_px: float
    scale_px: float
    joints: Array  # (J,)
    covariance: Array  # (6 + J, 6 + J)


@dataclass(frozen=True)
class Mode:
    """A cluster of the posterior."""

    weight: float
    pose: PoseEstimate
    spread: Spread


@dataclass(frozen=True)
class Rates:
    """How fast a pose changes against the camera: means and standard deviations in tangent units per second."""

    velocity: Array  # (6 + J,) rad/s about the body's axes, px/s, log scale per s, joints per s
    deviation: Array  # (6 + J,)


@dataclass(frozen=True)
class Goodness:
    """How well the best mode explains the light."""

    chi2: float  # mean square of what is left over, in units of what noise and discrepancy allow
    explained: float  # share of the light
    covered_dark: float  # share of the silhouette that shows no light


@dataclass(frozen=True)
class Estimate:
    """What a frame's answer holds (Eq. 5 and the posterior's shape)."""

    status: str
    mean: PoseEstimate
    best: PoseEstimate
    best_log_likelihood: float
    spread: Spread
    modes: tuple[Mode, ...]
    n_particles: int
    ess: float
    log_evidence: float
    rates: Rates | None = None  # of the mode that ``best`` belongs to; None: unknown
    spread_all: Spread | None = None  # over all particles, where ``spread`` is that of the best mode
    probabilities: Array | None = None  # (3,) of absent, fits, no_fit
    fit: Goodness | None = None
    light_scale: float | None = None
    """Scale at which the body's diameter just reaches across the frame's light: what is seen, whatever fits."""
