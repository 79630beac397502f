"""A dark body by day hides the sky that lies behind it: where that is brighter, it hides more (docs/model.md, 2)."""

import numpy as np
from lit_body import FINEST, QUALITY, SUN, VIEW, lit_body, pose, scene, shares

from service.inference.model.likelihood import fit_light
from service.inference.model.spread import PointSpread, spread
from service.inference.model.terms import terms_of

SIGMA, SKY, HIDES = 1.0, 60.0, 0.8
UNEVEN = np.tile(1 + 0.15 * np.cos(0.3 * np.arange(VIEW.side, dtype=np.float32)), (VIEW.side, 1))


def chi2(uneven: np.ndarray | None) -> float:
    """What is left over of a frame of a dark body before a sky that is so uneven."""
    body = lit_body()
    planes = body.planes(pose(), SUN, VIEW, QUALITY)
    light = np.tensordot(shares(body, 12.0), planes[0], 1) - HIDES * SKY * UNEVEN * planes[0, body.n_groups]
    noise = np.random.default_rng(3).normal(0, SIGMA, light.shape)
    image = spread(light[None].astype(np.float32), PointSpread(1.3), 0.0)[0] + noise
    told = {"sky": SKY, "uneven": uneven, "hides": HIDES * SKY, "low_pass": FINEST}
    terms = terms_of(scene(image, SIGMA, **told), body.n_groups, planes.shape[1])
    return fit_light(planes[0], body.n_groups, terms).chi2


def test_what_is_hidden_of_an_uneven_sky_is_what_lies_there():
    assert chi2(UNEVEN) < 1.5
    assert chi2(None) > 2.0
