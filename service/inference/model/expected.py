"""Where a body should show light (docs/model.md, section 5): what a patch must hold."""

from __future__ import annotations

import numpy as np

from service.inference.model.drawing import EVEN_PLANES, Drawing, Lens, Quality, View
from service.inference.model.terms import positive_priors
from service.inference.state import Array, Poses

_SIDE = 48  # numerical: patch px in which the whole body is drawn
_RIM = 1.05  # numerical: of its radius
_QUALITY = Quality(2, 96)  # numerical: a box asks for no more
_LEFT_OUT = 0.005  # numerical: of its light, beyond each side


def lit_box(
    drawing: Drawing, pose: Poses, sun: Array, paint: Array | None = None, lens: Lens | None = None
) -> Array | None:
    """Left, top, right, bottom (frame px) of the light of one pose under one Sun (1, 3); None: it shows none.

    ``paint`` (2, P): what is known of the surfaces (``model.paint``); None: nothing.
    """
    reach = _RIM * drawing.radius * float(np.exp(pose.log_scale[0]))
    x, y = pose.position[0]
    view = View((float(x) - reach, float(y) - reach), 2 * reach / _SIDE, _SIDE, lens)
    groups = drawing.n_groups
    n_planes = drawing.n_planes(_QUALITY)
    log_share, precision, facets = positive_priors(groups, n_planes, drawing.pieces)
    if paint is not None:
        whole = precision + paint[1]
        log_share = log_share + facets.expected(paint[0] * paint[1] / whole, whole)[0].astype(np.float32)
    shares = np.insert(np.exp(log_share), [groups] * EVEN_PLANES, 0.0).astype(np.float32)  # no even light
    light = drawing.combined(pose, sun, shares, view, _QUALITY)[0].astype(np.float64)
    if light.sum() <= 0.0:
        return None
    low, high = [], []
    for axis in (0, 1):
        filled = np.cumsum(light.sum(axis=axis)) / light.sum()
        low.append(np.searchsorted(filled, _LEFT_OUT))
        high.append(np.searchsorted(filled, 1 - _LEFT_OUT) + 1)
    return np.tile(view.origin, 2) + view.binning * np.array([*low, *high])
