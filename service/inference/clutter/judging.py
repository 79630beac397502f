"""Whether an outline before clutter is the body's: absent, fits, no_fit (docs/model.md, section 7)."""

from __future__ import annotations

import cv2
import numpy as np

from service.inference.clutter.outlook import Outlook
from service.inference.filters.status import SURE
from service.inference.model import prior
from service.inference.state import Array, Goodness, Poses

_RIM = 0.08  # numerical: of the size of a silhouette: how far about it another body's outline may lie
_SHOWN = 0.1  # numerical: of that which is covered thereabouts


def judged(outlook: Outlook, pose: Poses, ahead: Array) -> tuple[Array, Goodness]:
    """(3,) probabilities after a frame, from those ``ahead`` of it (3,); and how well the outline of a pose (1) fits.

    Absent: all is clutter. Something else: an outline of its own choice, all that looks like the body thereabouts, of
    so many freedoms as it is long.
    """
    covered, binning = outlook.covered(pose)[0], outlook.view.binning
    smooth = cv2.GaussianBlur(outlook.log_ratio, (0, 0), max(0.5 * prior.RIM_ALIKE_PX / binning, 0.5))
    size = np.sqrt(max(float(covered.sum()), 1.0))
    near = cv2.GaussianBlur(covered, (0, 0), max(_RIM * size, 1.0)) > _SHOWN
    like = np.where(near, np.maximum(smooth, 0), 0)
    worth = (binning / prior.CLUTTER_ALIKE_PX) ** 2
    held = float((outlook.log_ratio * covered).sum()) * worth
    price = prior.OUTLINE_FREEDOM * float(outlook.rims(covered[None])[0]) * binning / prior.RIM_ALIKE_PX
    log_evidence = np.array([0.0, held, float(like.sum()) * worth - price])
    weighed = np.log(ahead) + prior.EVIDENCE_TRUST * log_evidence
    seen = max(float(covered.sum()), 1e-9)
    fit = Goodness(
        chi2=max(float(like.sum()) * worth, 1e-9) / max(held, 1e-9),
        explained=float((like * covered).sum()) / max(float(like.sum()), 1e-9),
        covered_dark=float(((outlook.log_ratio < 0) * covered).sum()) / seen,
    )
    return np.asarray(np.exp(weighed - np.logaddexp.reduce(weighed))), fit


def told(here: Array) -> Array:
    """(3,) probabilities as they are told: of what fits an outline, so much is another body of this shape."""
    absent, fits, no_fit = here
    other = prior.ANOTHER_OF_ITS_SHAPE * fits
    return np.array([absent, fits - other, no_fit + other])


def status_of(probabilities: Array) -> str:
    """What is told of an outline: never that it is this body for sure, nor which of its twins."""
    absent, fits, _ = probabilities
    if absent >= SURE:
        return "no_target"
    return "ambiguous" if fits >= 0.5 else "no_fit"
