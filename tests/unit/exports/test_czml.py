"""CZML: Earth-fixed axes, X Y Z W, one interval per stretch."""

from dataclasses import replace
from datetime import timedelta

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import GCRS, ITRS, CartesianRepresentation, EarthLocation
from astropy.time import Time
from golden import ROTATIONS, START, history
from scipy.spatial.transform import Rotation

from service.attitude.camera import Site
from service.attitude.orbit import Orbit
from service.exports.czml import czml_packets


def test_every_rotation_takes_the_bodys_axes_to_earth_fixed_ones():
    document, packet = czml_packets(history())
    assert (document["id"], packet["id"]) == ("document", "1992-052A")
    intervals = packet["orientation"]
    assert [part["interval"] for part in intervals] == packet["availability"]
    k = 0
    for part in intervals:
        rows = np.array(part["unitQuaternion"]).reshape(-1, 5)
        assert np.all(np.sum(rows[1:, 1:] * rows[:-1, 1:], axis=1) >= 0)
        for seconds, *quaternion in rows:
            moment = Time(part["epoch"].removesuffix("Z"), scale="utc") + seconds * u.s
            axes = Rotation.from_quat(quaternion).as_matrix()  # SciPy's order is X, Y, Z, W too
            for column, expected in zip(axes.T[:2], ROTATIONS[k][1:], strict=True):
                np.testing.assert_allclose(column, earth_fixed(expected, moment), atol=1e-7)
            k += 1
    assert k == len(ROTATIONS)


def earth_fixed(gcrf, moment):
    point = GCRS(CartesianRepresentation(np.array(gcrf) * 7000 * u.km), obstime=moment)
    return point.transform_to(ITRS(obstime=moment)).cartesian.xyz.to_value(u.km) / 7000


def test_a_single_sample_is_a_constant():
    _, packet = czml_packets(history(breaks=(7,)))
    assert len(packet["orientation"][1]["unitQuaternion"]) == 4


TLE = """1 25544U 98067A   26324.50000000  .00016717  00000-0  10270-3 0  9002
2 25544  51.6400 208.9163 0006317  69.9862  25.2906 15.49815350 10006"""


def test_where_the_orbit_is_known_the_packet_has_its_place():
    orbit, site = Orbit(TLE), Site(48.2, 16.3, 250.0)
    _, packet = czml_packets(replace(history(), orbit=orbit))
    place = packet["position"]
    rows = np.array(place["cartesian"]).reshape(-1, 4)
    assert len(rows) == len(ROTATIONS)
    ground = EarthLocation.from_geodetic(16.3 * u.deg, 48.2 * u.deg, 250 * u.m)
    for seconds, *metres in rows:
        away = np.array(metres) - [axis.to_value(u.m) for axis in ground.geocentric]
        told = orbit.seen_from(site, START + timedelta(seconds=seconds))
        assert np.linalg.norm(away) == pytest.approx(1e3 * told.range_km, rel=1e-9)
    assert "position" not in czml_packets(history())[1]
    assert len(czml_packets(replace(history(), segments=history().segments[:1], orbit=orbit))[1]["position"]) == 4
