"""The dialog of a new track: several models to compare, and what is known of telescope, site and orbit."""

import httpx
import pytest
from fake_worker import CUBE
from playwright.sync_api import expect

TLE = """1 25544U 98067A   26324.50000000  .00016717  00000-0  10270-3 0  9009
2 25544  51.6400 208.9163 0006317  69.9862  25.2906 15.49815350 10000"""


@pytest.fixture
def frames(tmp_path):
    folder = tmp_path / "night"
    folder.mkdir()
    for n in range(4):
        (folder / f"{n}.png").write_bytes(b"x")  # nothing of them is read before they are sent
    return folder


@pytest.fixture
def models(server):
    """Names and ids of three models."""
    found = {}
    for name in ("Hubble", "Terra", "Aqua"):
        file = {"file": (f"{name}.glb", CUBE + f" joint {name}".encode())}
        found[name] = httpx.post(f"{server.url}/v1/models", files=file).raise_for_status().json()["model_id"]
    return found


def begun(page, press) -> dict:
    """The request for the session that pressing a button sends, which is answered with nothing."""
    page.route("**/v1/sessions", lambda route: route.abort())
    with page.expect_request(lambda request: request.method == "POST" and request.url.endswith("/v1/sessions")) as sent:
        press()
    return sent.value.post_data_json


def test_models_are_compared(server, open_page, frames, models):
    page = open_page(server.url, expect_failures=True)
    page.get_by_role("button", name="New track").click()
    page.set_input_files("input[name=folder]", frames)
    expect(page.get_by_text("Not sure which spacecraft it is?")).to_be_hidden()
    page.locator("select[name=model]").select_option("Hubble")
    expect(page.get_by_role("checkbox", name="panel")).to_be_checked()
    page.get_by_text("Not sure which spacecraft it is?").click()
    page.get_by_role("checkbox", name="Terra").check()
    page.get_by_role("checkbox", name="Aqua").check()
    expect(page.get_by_role("checkbox", name="panel")).to_be_hidden()
    expect(page.get_by_role("checkbox", name="Estimate the moving parts of each")).to_be_checked()
    page.get_by_role("checkbox", name="Aqua").uncheck()
    asked = begun(page, page.get_by_role("button", name="Track 4 frames").click)
    assert asked["model_ids"] == [models["Hubble"], models["Terra"]]
    assert "model_id" not in asked and asked["background"] == "auto"
    assert asked["joints"] == {"free": "all"}


def test_telescope_site_and_orbit(server, open_page, frames, models):
    page = open_page(server.url, expect_failures=True)
    page.get_by_role("button", name="New track").click()
    page.set_input_files("input[name=folder]", frames)
    page.locator("select[name=model]").select_option("Terra")
    page.get_by_text("Telescope, site and orbit").click()
    page.get_by_label("Mount").select_option("altaz")
    page.get_by_label("Image’s up from zenith (°)").fill("12.5")
    page.get_by_label("Pixel scale (arcsec)").fill("0.2")
    for name, value in (("Latitude", "-29.26"), ("Longitude", "-70.73"), ("Height", "2400")):
        page.get_by_label(name).fill(value)
    page.get_by_label("The image is a mirror image of the sky").check()
    page.get_by_label("Orbit").fill(TLE)
    page.get_by_label("Metres in a unit of the model").fill("1")
    asked = begun(page, page.get_by_role("button", name="Track 4 frames").click)
    assert asked["camera"] == {
        "mount": "altaz",
        "up_angle_deg": 12.5,
        "pixel_scale_arcsec": 0.2,
        "site_latitude_deg": -29.26,
        "site_longitude_deg": -70.73,
        "site_height_m": 2400,
        "mirrored": True,
    }
    assert asked["prior"] == {"unit_m": 1, "orbit": TLE}
    made = httpx.post(f"{server.url}/v1/sessions", json=asked).raise_for_status().json()
    assert made["camera"]["mount"] == "altaz"


def test_what_the_service_refuses_of_them_is_told(server, open_page, frames, models):
    page = open_page(server.url, expect_failures=True)
    page.get_by_role("button", name="New track").click()
    page.set_input_files("input[name=folder]", frames)
    page.locator("select[name=model]").select_option("Terra")
    page.get_by_text("Telescope, site and orbit").click()
    page.get_by_label("Latitude").fill("10")
    page.get_by_role("button", name="Track 4 frames").click()
    expect(page.locator("#create .problem")).to_contain_text("a site has a latitude and a longitude")
    page.get_by_label("Longitude").fill("20")
    page.get_by_label("Mount").select_option("altaz")
    assert "site_longitude_deg" in begun(page, page.get_by_role("button", name="Track 4 frames").click)["camera"]
