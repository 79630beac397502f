"""A mixture of modes as a filter holds it, for what is read off one."""

import numpy as np
from lit_body import SUN

from service.inference.model.existence import usual_chi2
from service.inference.pose import retract
from service.inference.state import Mixture, Poses

HELD = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[72.0, 72.0]]), np.log([10.0]), np.zeros((1, 0)))


def mixture(weights=(1.0,), existence=(0.0, 1.0, 0.0), searches=9, ever=False, misses=0, discrepancy=0.008) -> Mixture:
    """A radian apart, the first at ``HELD``."""
    n = len(weights)
    turn = np.zeros((n, 6))
    turn[:, 0] = np.arange(n)
    poses = retract(HELD[np.zeros(n, dtype=int)], turn)
    return Mixture(
        poses=poses,
        rates=np.zeros((n, 6)),
        covariance=np.tile(1e-4 * np.eye(12), (n, 1, 1)),
        suns=np.tile(SUN, (n, 1)),
        sun_sigmas=np.full(n, 0.0175),
        paint=np.zeros((n, 2, 6)),
        log_weights=np.log(np.array(weights)),
        existence=np.array(existence),
        point_spread=np.array([1.2, 0.0]),
        discrepancy=discrepancy,
        log_chi2=usual_chi2(),
        log_light=8.0,
        span_px=40.0,
        ever_tracked=ever,
        searches=searches,
        misses=misses,
        since_search=0,
    )
