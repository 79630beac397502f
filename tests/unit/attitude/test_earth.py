"""Earth orientation against astropy, which takes another way to the same data."""

from datetime import UTC, datetime, timedelta

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import GCRS, ITRS, CartesianRepresentation
from astropy.time import Time
from astropy.utils import iers

from service.attitude.earth import earth_orientation, gcrf_to_itrf, of_date_to_gcrf

MOMENTS = [datetime(2016, 12, 31, 23, 59, 59, tzinfo=UTC), datetime(2024, 3, 20, 3, 4, 5, 678000, tzinfo=UTC)]
ARCSECOND = np.deg2rad(1 / 3600)


@pytest.mark.parametrize("moment", MOMENTS)
def test_earth_fixed_axes_are_astropys(moment):
    time = Time(moment)
    axes = CartesianRepresentation(np.eye(3) * 7000 * u.km)
    fixed = GCRS(axes, obstime=time).transform_to(ITRS(obstime=time)).cartesian.xyz.to_value(u.km) / 7000
    np.testing.assert_allclose(gcrf_to_itrf(moment), fixed, atol=0.01 * ARCSECOND)


@pytest.mark.parametrize("moment", MOMENTS)
def test_ut1_is_astropys(moment):
    with iers.earth_orientation_table.set(iers.IERS_A.open(iers.IERS_A_FILE)):
        assert earth_orientation(moment).ut1_utc_s == pytest.approx(
            Time(moment).delta_ut1_utc, abs=1e-4
        )  # it prefers Bulletin B


def test_across_a_leap_second_the_earth_goes_on_turning():
    before, after = datetime(2016, 12, 31, 23, 59, 59, tzinfo=UTC), datetime(2017, 1, 1, tzinfo=UTC)
    change = gcrf_to_itrf(after) @ gcrf_to_itrf(before).T
    turned_deg = np.rad2deg(np.arccos((np.trace(change) - 1) / 2))
    assert turned_deg == pytest.approx(2 * 360 / 86164.1, rel=1e-3)  # two seconds lie between them


def test_precession_since_2000_is_what_almanacs_say():
    years = 24.0
    moment = datetime(2000, 1, 1, 12, tzinfo=UTC) + timedelta(days=365.25 * years)
    x, y, _ = of_date_to_gcrf(moment)[:, 0]  # the equinox of date goes back along the ecliptic by 50.3" a year
    assert np.rad2deg(np.arctan2(-y, x)) * 3600 == pytest.approx(46.1 * years, rel=0.02)  # its part in right ascension


def test_outside_of_the_data_it_says_so():
    far = earth_orientation(datetime(2060, 1, 1, tzinfo=UTC))
    assert not far.known and far.ut1_utc_s == 0 and far.age_days > 10_000
    assert earth_orientation(MOMENTS[1]).age_days < 0
    assert np.allclose(
        gcrf_to_itrf(datetime(2060, 1, 1, tzinfo=UTC)) @ gcrf_to_itrf(datetime(2060, 1, 1, tzinfo=UTC)).T, np.eye(3)
    )
