"""The Sun's direction and the Earth's shadow: as astropy and plain rays through the solar disc have them."""

from datetime import UTC, datetime, timedelta

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import (
    GCRS,
    ITRS,
    TEME,
    AltAz,
    CartesianRepresentation,
    EarthLocation,
    SkyCoord,
    get_body,
    get_sun,
)
from astropy.time import Time
from astropy.utils import iers
from sgp4.api import Satrec

from service.attitude.camera import Site, equatorial_camera
from service.attitude.earth import gcrf_to_itrf, zenith_frame
from service.attitude.orbit import Orbit
from service.attitude.pointing import CameraOrientation, Mount, Pointing, camera_orientation
from service.attitude.shadow import EARTH_RADIUS_KM, earth_aside, earthshine, shade, sunlit_share
from service.attitude.sun import AU_KM, in_camera, phase_angle_deg, sun_from_earth
from service.errors import InputError

TLE = (
    "1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991\n"
    "2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482"
)
EPOCH = datetime(2019, 12, 9, 16, 38, 29, tzinfo=UTC)
PLACES = {  # latitude, longitude, height
    "vienna": (48.23, 16.34, 250.0),
    "paranal": (-24.63, -70.40, 2635.0),
    "maui": (20.71, -156.26, 3055.0),
    "tromso": (69.65, 18.96, 10.0),
    "pole": (-90.0, 0.0, 2835.0),
}
EPOCHS = [
    datetime(2019, 12, 9, 16, 38, tzinfo=UTC) + timedelta(days=173.7 * n) for n in range(10)
]  # about the year, over five years
ABOUT = list(zip(EPOCHS, [*PLACES, *PLACES], strict=True))
SUN_RADIUS_KM = 695_700.0
POLAR_RADIUS_KM = 6356.752


@pytest.fixture(autouse=True)
def offline():
    with iers.conf.set_temp("auto_download", False):
        yield


def degrees_apart(one, other) -> float:
    one, other = (np.asarray(v) / np.linalg.norm(v) for v in (one, other))
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other)))


@pytest.mark.parametrize("moment", EPOCHS, ids=str)
def test_the_direction_is_astropys(moment):
    found = sun_from_earth(moment)
    expected = get_sun(Time(moment)).cartesian.xyz.to_value(u.km)
    assert degrees_apart(found, expected) < 0.0002  # under an arcsecond
    assert np.linalg.norm(found) == pytest.approx(np.linalg.norm(expected), rel=1e-5)


@pytest.mark.parametrize(("moment", "place"), ABOUT, ids=str)
def test_over_ten_sites_it_stands_where_astropy_says(moment, place):
    """Azimuth and elevation, astropy's with the site's own parallax and velocity."""
    latitude, longitude, height = PLACES[place]
    where = EarthLocation.from_geodetic(longitude, latitude, height)
    seen = get_body("sun", Time(moment), where).transform_to(AltAz(obstime=Time(moment), location=where))
    expected = [np.cos(seen.alt) * np.sin(seen.az), np.cos(seen.alt) * np.cos(seen.az), np.sin(seen.alt)]
    found = zenith_frame(latitude, longitude).T @ gcrf_to_itrf(moment) @ sun_from_earth(moment)
    assert degrees_apart(found, [float(part) for part in expected]) < 0.01


@pytest.mark.parametrize(("year", "fine"), [(1850, False), (1900, True), (2099, True), (2101, False)])
def test_a_time_without_an_ephemeris_is_refused(year, fine):
    moment = datetime(year, 6, 1, tzinfo=UTC)
    if fine:
        assert 0.98 * AU_KM < np.linalg.norm(sun_from_earth(moment)) < 1.02 * AU_KM
    else:
        with pytest.raises(InputError, match="1900 to 2100") as caught:
            sun_from_earth(moment)
        assert caught.value.field == "query:time"


def oriented(ra, dec, angle, mirrored=False) -> CameraOrientation:
    return CameraOrientation(equatorial_camera(ra, dec, angle, mirrored=mirrored), mirrored, None, None)


def test_known_directions_in_the_camera():
    ahead, north, west = np.eye(3)[0], np.eye(3)[2], -np.eye(3)[1]
    plain = oriented(0, 0, 0)  # towards the equinox, north up: the west is on the right
    np.testing.assert_allclose(in_camera(3 * ahead, plain), [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(in_camera(north, plain), [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(in_camera(west, plain), [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(in_camera(north, oriented(0, 0, 90)), [1, 0, 0], atol=1e-12)  # east up, north right
    mirror = oriented(0, 0, 0, mirrored=True)
    np.testing.assert_allclose(in_camera(ahead, mirror), [0, 0, 1], atol=1e-12)  # away is away
    np.testing.assert_allclose(in_camera(north, mirror), [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(in_camera(west, mirror), [-1, 0, 0], atol=1e-12)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize(("moment", "place"), ABOUT[:8:2], ids=str)
def test_the_sun_in_an_image_is_astropys(moment, place, mirrored):
    """An altazimuth camera: the Sun's offset to the image's up and right, and its distance from the centre."""
    latitude, longitude, height = PLACES[place]
    mount = Mount("altaz", up_angle_deg=0.0, mirrored=mirrored, site=Site(latitude, longitude, height))
    camera = camera_orientation(Pointing(azimuth_deg=130.0, elevation_deg=40.0), mount, moment)
    found = in_camera(sun_from_earth(moment), camera)
    where = EarthLocation.from_geodetic(longitude, latitude, height)
    frame = AltAz(obstime=Time(moment), location=where)
    centre = SkyCoord(130 * u.deg, 40 * u.deg, frame=frame)
    sun = get_body("sun", Time(moment), where).transform_to(frame)
    sun = SkyCoord(sun.az, sun.alt, frame=frame)
    angle, apart = centre.position_angle(sun).rad, centre.separation(sun).rad  # from the zenith through growing azimuth
    right = np.sin(apart) * np.sin(angle) * (-1 if mirrored else 1)
    expected = [right, -np.sin(apart) * np.cos(angle), np.cos(apart)]
    assert degrees_apart(found, expected) < 0.02
    assert phase_angle_deg(found) == pytest.approx(180 - np.rad2deg(apart), abs=0.02)


def test_phase_angle():
    assert phase_angle_deg(np.array([0.0, 0, -1])) == 0  # the Sun behind the observer
    assert phase_angle_deg(np.array([0.0, 0, 1])) == 180
    assert phase_angle_deg(np.array([0.6, 0.8, 0])) == pytest.approx(90)


def share_by_rays(place_km, sun_km, step=61) -> float:
    """Points of the Sun's disc whose ray to the satellite clears the ellipsoid of the Earth."""
    to_sun = sun_km - place_km
    across = np.linalg.svd(to_sun[None])[2][1:]
    x, y = np.meshgrid(*[np.linspace(-1, 1, step)] * 2)
    inside = x**2 + y**2 <= 1
    radius = SUN_RADIUS_KM / np.sqrt(1 - (SUN_RADIUS_KM / np.linalg.norm(to_sun)) ** 2)
    points = to_sun + radius * (x[inside][:, None] * across[0] + y[inside][:, None] * across[1])
    shape = 1 / np.array([EARTH_RADIUS_KM, EARTH_RADIUS_KM, POLAR_RADIUS_KM])
    a, b = ((points * shape) ** 2).sum(1), 2 * (points * shape) @ (place_km * shape)
    c = ((place_km * shape) ** 2).sum() - 1
    hidden = (b < 0) & (b**2 - 4 * a * c > 0)
    return float(1 - hidden.mean())


def astropys(moment) -> tuple[np.ndarray, np.ndarray]:
    """Satellite and Sun from the Earth's centre, GCRS, km."""
    time = Time(moment)
    _, teme_km, _ = Satrec.twoline2rv(*TLE.splitlines()).sgp4(time.jd1, time.jd2)
    place = TEME(CartesianRepresentation(teme_km * u.km), obstime=time).transform_to(GCRS(obstime=time))
    return place.cartesian.xyz.to_value(u.km), get_body("sun", time).cartesian.xyz.to_value(u.km)


SITE = Site(48.23, 16.34, 250.0)


def share_at(moment) -> float:
    return sunlit_share(np.array(Orbit(TLE).seen_from(SITE, moment).place_km), sun_from_earth(moment))


@pytest.mark.parametrize("revolution", range(10))
def test_every_eclipse_begins_and_ends_when_astropy_says(revolution):
    """Ten revolutions, over four days: the way through the penumbra within a second."""
    start = EPOCH + timedelta(hours=9.3 * revolution)
    seconds = np.arange(0, 93 * 60, 20.0)
    words = [shade(share_at(start + timedelta(seconds=s))) for s in seconds]
    assert {"sunlit", "umbra"} <= set(words)
    k = next(k for k in range(1, len(words)) if (words[k - 1] == "sunlit") and words[k] != "sunlit")
    edge = start + timedelta(seconds=seconds[k] - 20)
    fine = np.arange(0, 90, 1.0)
    ours = [share_at(edge + timedelta(seconds=s)) for s in fine]
    theirs = [share_by_rays(*astropys(edge + timedelta(seconds=s))) for s in fine]
    assert ours[0] == 1 and ours[-1] == 0
    for level in (0.98, 0.5, 0.02):
        crossed = [fine[np.argmax(np.array(shares) < level)] for shares in (ours, theirs)]
        assert abs(crossed[0] - crossed[1]) <= 1.0, level
    assert np.max(np.abs(np.array(ours) - theirs)) < 0.03


@pytest.mark.parametrize("site", PLACES)
def test_the_place_among_the_stars_is_astropys_over_every_site(site):
    latitude, longitude, height = PLACES[site]
    for hours in (0.0, 31.0):
        moment = EPOCH + timedelta(hours=hours)
        found = Orbit(TLE).seen_from(Site(latitude, longitude, height), moment).place_km
        expected, _ = astropys(moment)
        assert np.linalg.norm(np.array(found) - expected) < 0.05
        seen = ITRS(CartesianRepresentation(gcrf_to_itrf(moment) @ found * u.km), obstime=Time(moment))
        assert np.linalg.norm(seen.cartesian.xyz.to_value(u.km)) == pytest.approx(np.linalg.norm(found))


def test_shares_and_words_at_known_places():
    sun = np.array([AU_KM, 0, 0])
    assert (sunlit_share(np.array([7000.0, 0, 0]), sun), shade(1.0)) == (1.0, "sunlit")
    assert (sunlit_share(np.array([-7000.0, 0, 0]), sun), shade(0.0)) == (0.0, "umbra")
    edge = sunlit_share(np.array([-7000.0, EARTH_RADIUS_KM, 0]), sun)  # the Sun's centre on the limb
    assert edge == pytest.approx(0.5, abs=0.02) and shade(edge) == "penumbra"
    far = sunlit_share(np.array([-3e6, 0, 0]), sun)  # past the tip of the umbra: a ring is left
    assert far == pytest.approx(1 - ((EARTH_RADIUS_KM / 3e6) / (SUN_RADIUS_KM / (AU_KM + 3e6))) ** 2, abs=1e-3)


def test_earthshine():
    sun = np.array([AU_KM, 0, 0])
    noon = earthshine(np.array([7000.0, 0, 0]), sun)
    assert noon == pytest.approx(0.2 * (EARTH_RADIUS_KM / 7000) ** 2)
    dusk = earthshine(np.array([0, 7000.0, 0]), sun)
    assert dusk == pytest.approx(noon / np.pi)
    assert earthshine(np.array([-7000.0, 0, 0]), sun) == pytest.approx(0, abs=1e-9)
    assert earthshine(np.array([42_164.0, 0, 0]), sun) == pytest.approx(noon * (7000 / 42_164) ** 2)


@pytest.mark.parametrize("height_km", [400, 1500, 36_000])
def test_the_earth_lights_a_face_across_it_less(height_km):
    distance = EARTH_RADIUS_KM + height_km
    rim = np.arcsin(EARTH_RADIUS_KM / distance)
    rng = np.random.default_rng(0)
    cosine, turn = rng.uniform(np.cos(rim), 1.0, 400_000), rng.uniform(0, 2 * np.pi, 400_000)  # evenly over its disc
    facing, across = cosine.mean(), np.maximum(np.sqrt(1 - cosine**2) * np.cos(turn), 0).mean()
    assert earth_aside(np.array([0, distance, 0.0])) == pytest.approx(across / facing, rel=0.02)
