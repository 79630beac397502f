"""Phase screens follow Kolmogorov's law; point spreads keep light and place."""

import numpy as np
import pytest

from service.simulate.atmosphere import Air, Atmosphere
from service.simulate.turbulence import Turbulence, _phase_screen, _without_tilt, image_motion_px


def test_phase_without_tilt_has_the_variance_that_noll_gives():
    d_over_r0, n = 3.0, 48
    axis = (np.arange(n) + 0.5) / (0.5 * n) - 1
    inside = np.hypot(*np.meshgrid(axis, axis)) <= 1
    measured = []
    for seed in range(4):
        screen = _phase_screen(n / d_over_r0, np.random.default_rng(seed))
        blocks = screen[: 10 * n, : 10 * n].reshape(10, n, 10, n).swapaxes(1, 2).reshape(-1, n, n)
        measured += [_without_tilt(block, inside)[inside].var() for block in blocks]
    assert np.mean(measured) == pytest.approx(0.134 * d_over_r0 ** (5 / 3), rel=0.1)


@pytest.mark.parametrize("d_over_r0", [1.0, 4.0])
def test_point_spreads_are_centred_and_keep_the_light(d_over_r0):
    turbulence = Turbulence(d_over_r0, 2.0, 0.5, np.random.default_rng(1))
    for _ in range(3):
        psf = turbulence.next_psf()
        index = np.arange(len(psf))
        assert psf.min() >= 0
        assert psf.sum() == pytest.approx(1.0)
        assert (psf.sum(axis=0) * index).sum() == pytest.approx(len(psf) // 2, abs=0.05)
        assert (psf.sum(axis=1) * index).sum() == pytest.approx(len(psf) // 2, abs=0.05)


def test_worse_seeing_spreads_further():
    def peak(d_over_r0):
        turbulence = Turbulence(d_over_r0, 2.0, 0.5, np.random.default_rng(2))
        return np.mean([turbulence.next_psf().max() for _ in range(5)])

    assert peak(0.5) > peak(2.0) > peak(6.0)
    assert image_motion_px(1.0, 2.0) == pytest.approx(0.8246, abs=1e-3)


def test_air_neither_moves_the_body_nor_eats_its_light():
    air = Air(psf_sigma_px=1.0, d_over_r0=2.0, warp_px=1.0, scintillation=0.2)
    atmosphere = Atmosphere(air, (96, 96), np.random.default_rng(3))
    radiance = np.zeros((96, 96), dtype=np.float32)
    radiance[30:60, 40:70] = 1.0
    (seen,) = atmosphere.expose(radiance)
    y, x = np.mgrid[:96, :96]
    assert seen.sum() == pytest.approx(radiance.sum(), rel=0.05)
    assert (seen * x).sum() / seen.sum() == pytest.approx(54.5, abs=0.3)
    assert (seen * y).sum() / seen.sum() == pytest.approx(44.5, abs=0.3)
    gains = np.array([atmosphere.gain() for _ in range(2000)])
    assert gains.mean() == pytest.approx(1.0, abs=0.03)
    assert np.log(gains).std() == pytest.approx(0.2, abs=0.02)
