"""The part of a frame that holds the object's light: light above the sky, noise of photons, where it is, the patch."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from service.imaging.features import feature_spec
from service.imaging.patch import Light, cut, light_of
from service.imaging.pieces import find_light, pieces_of, wider
from service.imaging.sky import Sky

SHAPE = (120, 160)


def sky(sigma, mean=100.0) -> Sky:
    """Of as many channels as ``sigma`` has numbers."""
    sigma = np.asarray(sigma, np.float32)
    level = np.broadcast_to(np.asarray(mean, np.float32), (*SHAPE, len(sigma)))
    spec = feature_spec("intensity", len(sigma), 16, 1.0)
    return Sky(level, np.diag(sigma.astype(np.float64) ** 2), np.zeros(spec.n_bins), spec)


def light(image: np.ndarray, sigma: float = 1.0, **more) -> Light:
    return Light(image.astype(np.float32), sigma, 0.5, 10.0, **({"full": np.zeros(image.shape, bool)} | more))


def noise(seed: int = 1, shape=SHAPE) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=shape)


def with_box(left: int, top: int, right: int, bottom: int, counts: float) -> np.ndarray:
    image = np.zeros(SHAPE)
    image[top:bottom, left:right] = counts
    return image


def test_grey_light_is_what_is_above_the_sky():
    image = np.round(100 + 5 * noise() + with_box(40, 30, 80, 60, 200.0)).astype(np.uint16)
    found = light_of(image, sky([5.0]), 16)
    off = found.image - (image - 100.0)  # the frame's own level is known to the noise of all of its sky
    assert np.abs(off).max() < 0.5
    assert found.sigma == pytest.approx(5.0)
    assert not found.full.any() and found.unseen is None
    assert found.sky == pytest.approx(100.0, abs=1.0)


def test_where_the_sky_is_not_known_there_is_at_least_no_light():
    """As of pixels beyond the image: whatever a model shows there is no contradiction."""
    unsure = np.zeros(SHAPE, bool)
    unsure[100:110, 10:60] = True
    clock = with_box(12, 102, 50, 108, 900.0)
    image = np.round(100 + 5 * noise() + with_box(40, 30, 80, 60, 200.0) + clock).astype(np.uint16)
    found = light_of(image, replace(sky([5.0]), unsure=unsure), 16)
    np.testing.assert_array_equal(found.unseen, unsure)
    assert not found.image[unsure].any()
    assert len(pieces_of(found).boxes) == 1
    region = light_of(image, replace(sky([5.0]), unsure=unsure), 16, (slice(20, 120), slice(30, 90)))
    np.testing.assert_array_equal(region.unseen, unsure[20:120, 30:90])


def test_channels_are_weighed_by_their_precision():
    sigma, counts = np.array([2.0, 4.0, 8.0]), 50.0
    image = 100 + noise(shape=(*SHAPE, 3)) * sigma + with_box(40, 30, 80, 60, counts)[..., None]
    found = light_of(image, sky(sigma), 16)
    assert found.image[35:55, 45:75].mean() == pytest.approx(counts, abs=0.5)
    assert found.sigma == pytest.approx(np.sum(sigma**-2.0) ** -0.5)
    assert np.std(found.image[:25]) == pytest.approx(found.sigma, rel=0.05)
    alone = light_of(image[..., :1], sky(sigma[:1]), 16)
    assert found.sigma < alone.sigma


def test_noise_that_channels_have_in_common_is_counted_once():
    """As of a grey video decoded to colours."""
    seen = replace(sky([4.0, 4.0, 4.0]), fine=0.0)  # no frame tells
    alike = replace(seen, covariance=np.full((3, 3), 16.0))
    image = np.repeat(100 + 4 * noise()[..., None], 3, axis=2)
    assert light_of(image, seen, 16).sigma == pytest.approx(4 / np.sqrt(3))
    assert light_of(image, alike, 16).sigma == pytest.approx(4.0)


@pytest.mark.parametrize("size", [(40, 30, 80, 60), (20, 14, 140, 104)])
def test_a_frames_own_level_and_slope_are_no_light(size):
    """A moonrise of forty sigma, beside a small and a large object."""
    across, down = np.meshgrid(np.linspace(-60, 100, SHAPE[1]), np.linspace(0, 40, SHAPE[0]))
    body = with_box(*size, 300.0)
    found = light_of(100 + 4 * noise() + body + across + down, sky([4.0]), 16)
    dark = body == 0
    assert np.abs(found.image[dark]).mean() == pytest.approx(4 * np.sqrt(2 / np.pi), rel=0.1)
    assert found.image[~dark].mean() == pytest.approx(300.0, abs=3)


@pytest.mark.parametrize(("bits", "dtype"), [(8, np.uint8), (16, np.uint16)])
def test_a_full_channel_censors_the_pixel(bits, dtype):
    image = np.full((*SHAPE, 3), 100, dtype)
    image[20, 30, 1] = (1 << bits) - 1
    image[21, 30, 1] = (1 << bits) - 2
    found = light_of(image, sky([2.0, 2.0, 2.0]), bits)
    assert np.argwhere(found.full).tolist() == [[20, 30]]


@pytest.mark.parametrize("gain", [0.2, 1.0, 4.0])
def test_photon_transfer_is_found_from_one_frame(gain):
    """A body of two brightnesses with edges, blurred as by a telescope; counts per photon ``gain``."""
    shape = with_box(40, 30, 90, 80, 300.0) + with_box(95, 40, 130, 70, 800.0)
    clean = gaussian_filter(shape, 1.3)
    rng = np.random.default_rng(3)
    image = 100 + gain * rng.poisson(clean / gain) + 6.0 * rng.normal(size=SHAPE)
    found = light_of(image, sky([6.0]), 16)
    assert gain / 1.5 < found.photon < 1.5 * gain


@pytest.mark.parametrize("depth", [0.0, 40.0, 90.0])
def test_sky_that_is_hidden_had_no_more_photons_than_the_noise_that_the_sky_has(depth):
    """Fine structure leaks into the checkerboard; what is dark says how few photons a count is at the most."""
    image = 100 + 2 * noise()
    image[20:50, 30:60] += 400 * np.random.default_rng(2).uniform(size=(30, 30))
    image[70:100, 30:60] -= depth
    found = light_of(np.round(image).astype(np.uint16), sky([2.0]), 16)
    assert found.photon > 0.5 if not depth else found.photon == pytest.approx(4 / depth, rel=0.1)


def test_without_light_photons_are_taken_to_be_next_to_nothing():
    found = light_of(100 + 6 * noise(), sky([6.0]), 16)
    assert 0 < found.photon < 0.1


@pytest.mark.parametrize("brightness", [6.0, -6.0])
def test_a_body_is_found_bright_or_dark(brightness):
    """By day a body can be darker than the sky."""
    found = find_light(light(with_box(50, 40, 90, 70, brightness) + noise()))
    assert found is not None
    corners = (found.left, found.top, found.right, found.bottom)
    assert np.abs(np.subtract(corners, (50, 40, 90, 70))).max() <= 3
    assert found.side == pytest.approx(40, abs=6)
    assert found.centre == pytest.approx((70.0, 55.0), abs=2.0)


@pytest.mark.parametrize("seed", range(5))
def test_an_empty_sky_has_nothing(seed):
    assert find_light(light(noise(seed))) is None


def star(x: float, y: float, flux: float) -> np.ndarray:
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return flux / (2 * np.pi * 1.5**2) * np.exp(-0.5 * ((columns - x) ** 2 + (rows - y) ** 2) / 1.5**2)


def test_stars_are_not_the_object_nor_of_it():
    body = with_box(50, 40, 90, 70, 8.0)
    alone, among = (
        find_light(light(body + stars + noise())) for stars in (0.0, star(110, 30, 900) + star(20, 90, 900))
    )
    assert alone == among


def test_what_may_be_a_star_is_told_apart_where_it_is():
    """On the patch too, however coarse; never what is of the object."""
    image = with_box(50, 40, 90, 70, 8.0) + star(110, 30, 900) + star(95, 80, 300) + noise()
    given = light(image)
    pieces = pieces_of(given)
    marked = pieces.stars_of(given, find_light(given, pieces))
    assert marked.stars is not None
    assert (marked.stars[30, 110], marked.stars[80, 95]) == (1, 2)  # the brighter first
    assert not marked.stars[40:70, 50:90].any()
    assert np.count_nonzero(marked.stars) < 150
    whole, coarse = (cut(marked, (80.0, 60.0), 60.0, wanted) for wanted in (80.0, 30.0))
    assert set(np.unique(whole.stars)) == set(np.unique(coarse.stars)) == {0, 1, 2}
    x, y = (int(v) for v in whole.origin)
    assert np.array_equal(whole.stars, marked.stars[y : y + whole.side, x : x + whole.side])


@pytest.mark.parametrize(("known_px", "may_be"), [(0.0, False), (9.0, False), (40.0, True)])
def test_what_is_no_larger_than_a_star_may_be_one_where_the_object_is_known_to_be_larger(known_px, may_be):
    """If the object is absent: where it is there, the light is its own."""
    given = light(star(110, 30, 900) + star(20, 90, 300) + noise())
    pieces = pieces_of(given)
    marked = cut(pieces.stars_of(given, find_light(given, pieces), known_px), (70.0, 60.0), 150.0, 256.0)
    x, y = (int(v) for v in marked.origin)
    assert marked.stars[30 - y, 110 - x] == 0 and marked.stars[90 - y, 20 - x] == 1 + may_be
    assert (marked.stars_alone is not None) == may_be
    if may_be:
        assert marked.stars_alone[30 - y, 110 - x] == 1 and marked.stars_alone[90 - y, 20 - x] == 2
    beside = light(with_box(50, 40, 90, 70, 8.0) + star(110, 30, 900) + noise())
    pieces = pieces_of(beside)
    assert not pieces.stars_of(beside, find_light(beside, pieces), known_px).stars[40:70, 50:90].any()


def test_stars_do_not_lead_from_one_to_the_next_away_from_the_object():
    """Each would lie near what those before it span."""
    chain = sum(star(87 + 9 * k, 55, 110) for k in range(1, 8))
    alone, among = (find_light(light(with_box(50, 40, 90, 70, 8.0) + more + noise())) for more in (0.0, chain))
    assert alone is not None and among is not None
    assert among.right < alone.right + 20
    assert len(pieces_of(light(with_box(50, 40, 90, 70, 8.0) + chain + noise())).boxes) == 8


def test_a_wider_sight_holds_almost_all_light_and_no_more():
    """Specks of one body, far apart; stars that hold a hundredth of the light."""
    specks = star(40, 40, 900) + star(75, 70, 700) + star(110, 80, 400)
    given = light(specks + star(150, 10, 25) + noise())
    pieces = pieces_of(given)
    box = find_light(given, pieces)
    assert box is not None and box.right < 50
    found = wider(given, pieces, box)
    assert found.left <= 40 and 110 <= found.right < 130 and found.top > 25
    alone = light(star(40, 40, 900) + noise())
    box = find_light(alone)
    assert box is not None and wider(alone, pieces_of(alone), box) == box


def test_pieces_nearby_belong_to_the_object_and_far_ones_do_not():
    """A panel in the light, its boom in shadow."""
    body, panel, other = with_box(30, 40, 60, 70, 8.0), with_box(68, 45, 90, 65, 8.0), with_box(135, 90, 155, 110, 8.0)
    found = find_light(light(body + panel + other + noise()))
    assert found is not None
    assert (found.left, found.right) == pytest.approx((30, 90), abs=3)
    assert found.bottom == pytest.approx(70, abs=3)


def test_a_patch_at_full_resolution_is_the_frame():
    image = noise()
    found = cut(light(image, sigma=2.0), (80.0, 60.0), 30.0, 80.0)
    assert found.binning == 1
    assert found.side % 16 == 0 and found.side >= 30 + 2 * 8
    x, y = (int(v) for v in found.origin)
    assert np.array_equal(found.image, image.astype(np.float32)[y : y + found.side, x : x + found.side])
    assert (x + found.side / 2, y + found.side / 2) == pytest.approx((80.0, 60.0), abs=1.0)
    assert (found.sigma, found.photon, found.sky) == (2.0, 0.5, 10.0)


def test_squares_of_pixels_are_their_means_and_their_noise_is_less():
    shape = (400, 400)
    image = noise(shape=shape) + 3.0
    found = cut(light(image), (200.0, 200.0), 240.0, 80.0)
    assert found.binning == 3
    x, y = (int(v) for v in found.origin)
    block = image[y + 6 : y + 9, x + 9 : x + 12]
    assert found.image[2, 3] == pytest.approx(block.mean(), abs=1e-5)
    inside = ~found.unseen
    assert np.std(found.image[inside]) == pytest.approx(found.sigma, rel=0.05)
    assert found.sigma == pytest.approx(1 / 3)
    assert found.photon == pytest.approx(0.5 / 9)
    assert found.sky == 10.0  # counts of a frame pixel, as the image
    assert found.image[inside].mean() == pytest.approx(3.0, abs=0.05)


@pytest.mark.parametrize("span_px", [100.0, 110.0, 130.0])
def test_a_patch_of_parts_of_pixels_keeps_light_place_and_noise(span_px):
    """After the low pass that the likelihood gives it, noise is that of as many whole pixels."""
    rows, columns = np.mgrid[:400, :400] + 0.5
    spot = 500 * np.exp(-0.5 * ((columns - 207.3) ** 2 + (rows - 191.6) ** 2) / 6.0**2)
    found = cut(light(spot), (200.0, 200.0), span_px, 80.0)
    assert found.binning == pytest.approx(span_px / 80, abs=0.01)
    assert found.image.sum() * found.binning**2 == pytest.approx(spot.sum(), rel=1e-3)
    at = np.arange(found.side) + 0.5
    middle = np.array([found.image.sum(0) @ at, found.image.sum(1) @ at]) / found.image.sum()
    assert middle * found.binning + found.origin == pytest.approx((207.3, 191.6), abs=0.02)
    assert found.image.max() == pytest.approx(500.0, rel=0.03)
    some = cut(light(noise(shape=(400, 400))), (200.0, 200.0), span_px, 80.0)
    smooth = gaussian_filter(some.image, 1.0)[8:-8, 8:-8]
    assert smooth.std() == pytest.approx(some.sigma / (2 * np.sqrt(np.pi)), rel=0.1)


@pytest.mark.parametrize("centre", [(2.0, 60.0), (80.0, 118.0), (0.0, 0.0), (-500.0, 60.0)])
def test_outside_of_the_frame_nothing_is_known(centre):
    image = noise() + 5.0
    found = cut(light(image), centre, 30.0, 80.0)
    columns, rows = (found.origin[k] + np.arange(found.side) for k in (0, 1))
    inside = ((rows >= 0) & (rows < SHAPE[0]))[:, None] & ((columns >= 0) & (columns < SHAPE[1]))[None]
    assert np.array_equal(found.unseen, ~inside)
    assert not found.image[~inside].any() and not found.full.any()


def test_full_pixels_say_nothing_of_the_noise_of_photons():
    """They have none. The sensor's upper end is below the file's."""
    bright = np.zeros(SHAPE)
    bright[30:90, 40:120] = np.linspace(150.0, 500.0, 80)
    image = 100 + bright + np.sqrt(4 + 2.0 * bright) * noise()
    both = np.rint(image), np.minimum(np.rint(image), 450)
    clean, full = (light_of(one[..., None], sky([2.0]), 16) for one in both)
    assert full.full.sum() > 1500 and not clean.full.any()
    assert full.full[50, 118] and not full.full[50, 41] and not full.full[10, 10]
    assert full.photon == pytest.approx(clean.photon, rel=0.5)


@pytest.mark.parametrize("of", ["full", "unseen"])
def test_a_square_with_one_pixel_of_which_nothing_is_known_is_not_known_and_with_one_full_one_in_part(of):
    one = np.zeros((400, 400), bool)
    one[205, 203] = True
    found = cut(light(noise(shape=(400, 400)), **{of: one}), (200.0, 200.0), 240.0, 80.0)
    at = np.argwhere(getattr(found, of))
    assert len(at[(at > 5).all(axis=1) & (at < found.side - 5).all(axis=1)]) == 1
    row, column = (int((v - o) // 3) for v, o in zip((205, 203), found.origin[::-1], strict=True))
    assert getattr(found, of)[row, column] == pytest.approx({"full": 1 / 9, "unseen": 1}[of])
