"""Range and place in the sky out of mean elements: as astropy has them, however the elements are written."""

import json
from datetime import UTC, datetime, timedelta

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import ITRS, TEME, AltAz, CartesianRepresentation, EarthLocation
from astropy.time import Time
from sgp4.api import Satrec
from sgp4.exporter import export_omm

from service.attitude.camera import Site
from service.attitude.orbit import Orbit, check_sums
from service.errors import ConfigError, InputError

TLE = (
    "ISS (ZARYA)\n"
    "1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991\n"
    "2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482\n"
)
EPOCH = datetime(2019, 12, 9, 16, 38, 29, 363424, UTC)
SITES = {"vienna": Site(48.23, 16.34, 250.0), "paranal": Site(-24.63, -70.40, 2635.0)}


def fields() -> dict:
    return export_omm(Satrec.twoline2rv(*TLE.splitlines()[1:]), "ISS (ZARYA)")


def as_xml(values: dict) -> str:
    groups = {"metadata": ("OBJECT_ID", "MEAN_ELEMENT_THEORY"), "tleParameters": ("BSTAR", "NORAD_CAT_ID")}
    rest = [name for name in values if not any(name in names for names in groups.values())]

    def element(group: str, names) -> str:
        inner = "".join(f"<{name}>{values[name]}</{name}>" for name in names if name in values)
        return f"<{group}>{inner}</{group}>"

    data = element("meanElements", rest) + element("tleParameters", groups["tleParameters"])
    metadata = element("metadata", groups["metadata"])
    return f"<ndm><omm><body><segment>{metadata}<data>{data}</data></segment></body></omm></ndm>"


def as_kvn(values: dict) -> str:
    return "CCSDS_OMM_VERS = 2.0\n" + "\n".join(f"{name} = {value}" for name, value in values.items())


@pytest.mark.parametrize("site", SITES)
@pytest.mark.parametrize("hours", [0.0, 0.4, 30.0])
def test_range_and_direction_are_astropys(site, hours):
    where, moment = SITES[site], EPOCH + timedelta(hours=hours)
    found = Orbit(TLE).seen_from(where, moment)
    _, teme_km, _ = Satrec.twoline2rv(*TLE.splitlines()[1:]).sgp4(Time(moment).jd1, Time(moment).jd2)
    time = Time(moment)
    place = EarthLocation.from_geodetic(where.longitude_deg, where.latitude_deg, where.height_m)
    fixed = TEME(CartesianRepresentation(teme_km * u.km), obstime=time).transform_to(ITRS(obstime=time))
    topocentric = ITRS(fixed.cartesian - place.get_itrs(time).cartesian, obstime=time, location=place)
    seen = topocentric.transform_to(AltAz(obstime=time, location=place))
    assert found.range_km == pytest.approx(seen.distance.km, abs=0.05)
    assert found.elevation_deg == pytest.approx(seen.alt.deg, abs=0.01)
    turn = (found.azimuth_deg - seen.az.deg + 180) % 360 - 180
    assert abs(turn) * np.cos(seen.alt.rad) < 0.01
    assert found.elements_age_days == pytest.approx(hours / 24, abs=1e-6)
    assert found.earth.known and found.earth.age_days < 0  # 2019 was measured


@pytest.mark.parametrize(
    "text",
    [
        "\n".join(TLE.splitlines()[1:]),
        json.dumps(fields()),
        json.dumps([{**fields(), "EPOCH": fields()["EPOCH"] + "00Z", "BSTAR": str(fields()["BSTAR"])}]),
        as_xml(fields()),
        as_kvn(fields()),
    ],
    ids=["two lines", "json", "json list", "xml", "kvn"],
)
def test_every_form_says_the_same(text):
    moment = EPOCH + timedelta(hours=5)
    named, other = (Orbit(form).seen_from(SITES["vienna"], moment) for form in (TLE, text))
    assert other.range_km == pytest.approx(named.range_km, abs=1e-3)
    assert abs(Orbit(text).epoch - EPOCH) < timedelta(milliseconds=1)


@pytest.mark.parametrize(
    "text",
    [
        "hello",
        "[]",
        '"TLE"',
        TLE.replace("25544U", "25545U"),
        json.dumps({**fields(), "MEAN_ELEMENT_THEORY": "SGP4-XP"}),
        json.dumps({**fields(), "ECCENTRICITY": 1.5}),
        json.dumps({key: value for key, value in fields().items() if key != "INCLINATION"}),
        "<ndm>",
        '<!DOCTYPE x [<!ENTITY a "b">]>',
    ],
)
def test_what_is_no_orbit_is_refused(text):
    with pytest.raises(ConfigError) as caught:
        Orbit(text)
    assert caught.value.field == "prior.orbit"


def test_a_decayed_orbit_has_no_place():
    fast = json.dumps({**fields(), "BSTAR": 0.5})
    with pytest.raises(InputError, match="no place at this time"):
        Orbit(fast).seen_from(SITES["vienna"], EPOCH + timedelta(days=400))


@pytest.mark.parametrize(
    ("spoilt", "said"),
    [
        (("51.6", "5x.6"), "TLE line 2, inclination"),
        (("15.49", "15,49"), "TLE line 2, mean motion"),
        (("26324.5", "2632A.5"), "TLE line 1, epoch"),
        (("2 25544", "2 25545"), "two objects, 25544 and 25545"),
        (("2 25544", "3 25544"), "begins with 1"),
    ],
)
def test_a_tle_that_fails_names_its_line_and_field(spoilt, said):
    good = (
        "1 25544U 98067A   26324.50000000  .00016717  00000-0  10270-3 0  9009\n"
        "2 25544  51.6400 208.9163 0006317  69.9862  25.2906 15.49815350 10000"
    )
    Orbit(good)
    assert not check_sums(good)
    with pytest.raises(ConfigError, match=said):
        Orbit(good.replace(*spoilt))


def test_a_checksum_that_is_wrong_names_its_line_and_the_digit():
    for good in (TLE, "\n".join(line[:68] for line in TLE.splitlines()[-2:]), json.dumps(fields())):
        assert not check_sums(good)
    spoilt = TLE.replace("211.2001", "211.2007")
    Orbit(spoilt)
    (said,) = check_sums(spoilt)
    assert said.startswith("prior.orbit: TLE line 2, checksum (column 69): '2', but the line's digits make 8")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("hello", "neither a TLE .* nor an OMM"),
        ("CREATION_DATE = 2026", "the OMM has no EPOCH, MEAN_MOTION"),
        ("<ndm></ndm>", "the OMM has no EPOCH"),
        ('<!DOCTYPE ndm [<!ENTITY a "b">]><ndm>&a;</ndm>', "DTDForbidden"),
        ("[]", "an OMM as JSON is an object"),
    ],
)
def test_what_is_missing_is_named(text, said):
    with pytest.raises(ConfigError, match=said):
        Orbit(text)
