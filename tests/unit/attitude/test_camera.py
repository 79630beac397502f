"""Where the camera looks and what is up, against the sky as astropy draws it."""

from datetime import UTC, datetime

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import AltAz, EarthLocation, SkyCoord
from astropy.time import Time

from service.attitude.absolute import absolute_quaternion, body_rate, camera_rate, covariance_in_gcrf
from service.attitude.camera import Site, camera_axes, equatorial_camera, towards, zenith
from service.attitude.pointing import Mount, Pointing, camera_orientation
from service.errors import InputError
from service.inference.pose import exp_so3, from_matrices, log_so3, multiply, rotation_matrices

MOMENT = datetime(2026, 11, 20, 3, 4, 5, tzinfo=UTC)
SITES = {"north": Site(48.2, 16.4), "south": Site(-30.24, -70.74)}


def angle_deg(a, b) -> float:
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def rotation_angle_deg(a, b) -> float:
    return float(np.rad2deg(np.linalg.norm(log_so3(from_matrices(a.T @ b)))))


def test_north_up_puts_the_east_on_the_left():
    right, down, forward = equatorial_camera(0, 0, 0).T
    np.testing.assert_allclose(forward, [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(down, [0, 0, -1], atol=1e-15)
    np.testing.assert_allclose(right, [0, -1, 0], atol=1e-15)  # right ascension grows to the left


@pytest.mark.parametrize(("ra", "dec", "pa"), [(0, 0, 90), (210, -40, 33), (83, 89.9, -120), (300, -90, 10)])
def test_up_has_its_position_angle(ra, dec, pa):
    axes = equatorial_camera(ra, dec, pa)
    assert np.linalg.det(axes) == pytest.approx(1)
    if abs(dec) < 90:
        centre = SkyCoord(ra * u.deg, dec * u.deg)
        above = axes[:, 2] - 1e-6 * axes[:, 1]
        seen = SkyCoord(*above, representation_type="cartesian").spherical
        position = centre.position_angle(SkyCoord(seen.lon, seen.lat)).to_value(u.deg)
        assert (position - pa + 180) % 360 - 180 == pytest.approx(0, abs=1e-3)


def test_a_mirrored_image_has_its_right_on_the_other_side_and_is_still_a_rotation():
    plain, mirrored = equatorial_camera(120, 30, 20), equatorial_camera(120, 30, 20, mirrored=True)
    np.testing.assert_allclose(mirrored[:, 0], -plain[:, 0])
    np.testing.assert_allclose(mirrored[:, 1], plain[:, 1])
    assert np.linalg.det(mirrored) == pytest.approx(1)


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_mirrored_silhouette_gives_the_same_attitude(mirrored):
    """Points of a body of known attitude, imaged by hand; the filter's pose of that image; back to GCRF."""
    rng = np.random.default_rng(3)
    body_to_gcrf = rotation_matrices(exp_so3(rng.normal(size=3)))
    points = rng.normal(size=(20, 3))
    camera = equatorial_camera(200, -35, 77)
    image = (points @ body_to_gcrf.T @ camera)[:, :2]
    if mirrored:
        image[:, 0] *= -1
    # The affine pose that fits the image: the first two rows by least squares, the third by the right hand.
    rows = np.linalg.lstsq(points, image, rcond=None)[0].T
    pose = from_matrices(np.vstack([rows, np.cross(*rows)]))
    found = absolute_quaternion(equatorial_camera(200, -35, 77, mirrored=mirrored), pose)
    np.testing.assert_allclose(rotation_matrices(found), body_to_gcrf, atol=1e-12)


@pytest.mark.parametrize("site", SITES.values(), ids=SITES.keys())
@pytest.mark.parametrize(("azimuth", "elevation"), [(10, 30), (190, 60), (275, 85), (100, 15)])
def test_azimuth_and_elevation_against_astropy(site, azimuth, elevation):
    mount = Mount("altaz", up_angle_deg=25.0, site=site)
    camera = camera_orientation(Pointing(azimuth_deg=azimuth, elevation_deg=elevation), mount, MOMENT)
    place = EarthLocation.from_geodetic(site.longitude_deg, site.latitude_deg, 100)
    frame = AltAz(obstime=Time(MOMENT), location=place)
    # Up in the image: 25 degrees from the zenith in the sense north through east, towards lower azimuths.
    looked = SkyCoord(azimuth * u.deg, elevation * u.deg, frame=frame)
    upward = looked.directional_offset_by(-25 * u.deg, 0.1 * u.deg)
    stars = [point.transform_to("icrs").cartesian.xyz.value for point in (looked, upward)]
    assert angle_deg(camera.to_gcrf[:, 2], stars[0]) < 0.007  # aberration: 20.5", not of a body near the Earth
    assert rotation_angle_deg(camera_axes(stars[0], stars[1], 0), camera.to_gcrf) < 0.02
    assert camera.earth is not None and camera.earth.known


@pytest.mark.parametrize("site", SITES.values(), ids=SITES.keys())
def test_field_rotation_of_an_altaz_mount_that_tells_right_ascension(site):
    """The same direction told in both ways gives the same camera."""
    mount = Mount("altaz", up_angle_deg=-40.0, site=site)
    horizontal = camera_orientation(Pointing(azimuth_deg=130, elevation_deg=40), mount, MOMENT)
    x, y, z = horizontal.to_gcrf[:, 2]
    ra, dec = np.rad2deg([np.arctan2(y, x), np.arcsin(z)])
    equatorial = camera_orientation(Pointing(ra_deg=ra, dec_deg=dec), mount, MOMENT)
    np.testing.assert_allclose(equatorial.to_gcrf, horizontal.to_gcrf, atol=1e-9)
    assert angle_deg(zenith(site, MOMENT), horizontal.to_gcrf[:, 2]) == pytest.approx(50)


def test_coordinates_of_date_are_turned_by_precession():
    place = Pointing(ra_deg=150, dec_deg=20, position_angle_deg=0)
    plain = camera_orientation(place, Mount(), MOMENT).to_gcrf
    of_date = camera_orientation(place, Mount(equinox="date"), MOMENT).to_gcrf
    assert 0.3 < rotation_angle_deg(plain, of_date) < 0.45
    told = camera_orientation(Pointing(150, 20, position_angle_deg=0, equinox="J2000"), Mount(equinox="date"), MOMENT)
    np.testing.assert_array_equal(told.to_gcrf, plain)


def test_what_is_unknown_is_none_and_what_is_half_known_is_refused():
    assert camera_orientation(Pointing(), Mount(), MOMENT) is None
    assert camera_orientation(Pointing(10, 20), Mount(), MOMENT) is None
    assert camera_orientation(Pointing(10, 20), Mount(up_angle_deg=0), MOMENT) is not None
    for bad in (Pointing(ra_deg=10), Pointing(elevation_deg=10), Pointing(azimuth_deg=10, elevation_deg=20)):
        with pytest.raises(InputError):
            camera_orientation(bad, Mount(up_angle_deg=0), MOMENT)


@pytest.mark.parametrize("mirrored", [False, True])
def test_an_object_off_the_axis_is_seen_along_its_ray(mirrored):
    camera = equatorial_camera(40, 50, 60, mirrored=mirrored)
    turned = towards(camera, 0.4, -0.3, mirrored=mirrored)
    away = -1 if mirrored else 1
    ray = away * camera[:, 2] + camera[:, :2] @ np.tan(np.deg2rad([0.4, -0.3]))
    assert angle_deg(away * turned[:, 2], ray) < 1e-9
    assert rotation_angle_deg(camera, turned) == pytest.approx(0.5, rel=1e-4)
    np.testing.assert_allclose(turned.T @ turned, np.eye(3), atol=1e-14)


def test_rates_add_and_covariance_turns_along():
    rng = np.random.default_rng(4)
    dt, inertial_rate, camera_turn = 1e-4, rng.normal(size=3), rng.normal(size=3)
    body, camera = exp_so3(rng.normal(size=3)), exp_so3(rng.normal(size=3))

    def later(q, rate):  # rate in fixed axes
        return multiply(exp_so3(rate * dt), q)

    def seen(b, c):
        return multiply(c * [1, -1, -1, -1], b)

    body_1, camera_1 = later(body, inertial_rate), later(camera, camera_turn)
    relative = log_so3(multiply(seen(body, camera) * [1, -1, -1, -1], seen(body_1, camera_1))) / dt
    turn = camera_rate(rotation_matrices(camera), rotation_matrices(camera_1), dt)
    found = body_rate(seen(body_1, camera_1), relative, turn)
    np.testing.assert_allclose(found, rotation_matrices(body_1).T @ inertial_rate, atol=1e-3)
    covariance = np.diag([1.0, 4.0, 9.0])
    turned = covariance_in_gcrf(body, covariance)
    axes = rotation_matrices(body)
    np.testing.assert_allclose([axes[:, k] @ turned @ axes[:, k] for k in range(3)], [1, 4, 9])
