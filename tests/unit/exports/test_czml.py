"""CZML: Earth-fixed axes, X Y Z W, one interval per stretch."""

import astropy.units as u
import numpy as np
from astropy.coordinates import GCRS, ITRS, CartesianRepresentation
from astropy.time import Time
from golden import ROTATIONS, history
from scipy.spatial.transform import Rotation

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
