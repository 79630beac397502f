"""What a frame says given earlier frames, and what it leaves for the next: which path, and what is remembered."""

from collections.abc import Mapping

import numpy as np
import pytest
from scipy import ndimage

from service.imaging.background import Sky, derive, known_pixels, learn
from service.imaging.decode import Frame as Image
from service.imaging.features import feature_spec
from service.imaging.region import first_region, learn_region
from service.inference.params import CameraParams, LikelihoodParams, SessionConfig
from service.workers.observation import observe, remember

SIZE = 96
BODY = np.zeros((SIZE, SIZE), bool)
BODY[38:58, 33:63] = True
BOX = (24.0, 28.0, 48.0, 40.0)  # x, y, w, h about the body


def picture(seed: int, *, body: float = 120.0, psf_px: float = 1.5) -> Image:
    rng = np.random.default_rng(seed)
    light = ndimage.gaussian_filter(np.where(BODY, body, 0.0), psf_px)
    counts = 20 + light + 2 * rng.standard_normal((SIZE, SIZE))
    return Image(np.clip(np.rint(counts), 0, 255).astype(np.uint8), 8, 1)


def sky_of(images: list[Image], known: np.ndarray) -> Sky:
    background = None
    for image in images:
        background = learn(background, image.image, 8, feature_spec("auto", 1, 8, 1.0), known)
    assert background is not None
    return derive(background, "auto", 1.0)


@pytest.fixture(scope="module")
def empty_sky() -> Sky:
    """Learned from empty frames: holds per pixel."""
    return sky_of([picture(k, body=0.0) for k in range(4)], np.ones((SIZE, SIZE), bool))


@pytest.fixture(scope="module")
def boxed_sky() -> Sky:
    """Learned around the object, where there never was an empty frame."""
    return sky_of([SHARP], known_pixels(SIZE, SIZE, BOX, None))


SHARP = picture(1, psf_px=0.4)  # levels alone tell object from surroundings: a blurred edge is like neither


def config(**likelihood) -> SessionConfig:
    return SessionConfig(likelihood=LikelihoodParams(**likelihood))


def never() -> np.ndarray:
    raise AssertionError("no silhouette is needed")


def found(log_ratio: np.ndarray) -> float:
    """Intersection over union of the favoured pixels and the body."""
    return float(np.sum((log_ratio > 0) & BODY) / np.sum((log_ratio > 0) | BODY))


def test_empty_frames_lead_to_the_contrast_map(empty_sky):
    observation = observe(picture(7), empty_sky, config(), {})
    assert observation.region is None
    assert found(observation.maps.log_ratio) > 0.9
    assert observation.maps.psf_sigma_px == pytest.approx(1.5, rel=0.3)


def test_the_histogram_map_needs_no_point_spread(empty_sky, boxed_sky):
    """The paper's map is the paper's, with or without an empty frame; nothing is remembered of it."""
    for sky in (empty_sky, boxed_sky):
        observation = observe(picture(7), sky, config(kind="histogram"), {})
        assert observation.region is None
        assert observation.maps.psf_sigma_px is None
        assert remember(observation, picture(7), {}, True, never) == {}


def test_a_given_point_spread_is_taken(empty_sky):
    settings = SessionConfig(camera=CameraParams(psf_sigma_px=2.5))
    assert observe(picture(7), empty_sky, settings, {"psf_sigma_px": np.array(9.0)}).maps.psf_sigma_px == 2.5


def test_the_point_spread_of_earlier_frames_counts_two_thirds(empty_sky):
    own = observe(picture(7), empty_sky, config(), {}).maps.psf_sigma_px
    mixed = observe(picture(7), empty_sky, config(), {"psf_sigma_px": np.array(3.0)}).maps.psf_sigma_px
    assert own is not None
    assert mixed == pytest.approx((own + 2 * 3.0) / 3)


def test_the_point_spread_is_remembered_while_tracking_only(empty_sky):
    observation = observe(picture(7), empty_sky, config(), {})
    width = observation.maps.psf_sigma_px
    assert remember(observation, picture(7), {}, False, never) == {}
    first = remember(observation, picture(7), {}, True, never)
    assert float(np.asarray(first["psf_sigma_px"])) == pytest.approx(width)
    later = remember(observation, picture(7), {"psf_sigma_px": np.array(3.0)}, True, never)
    assert float(np.asarray(later["psf_sigma_px"])) == pytest.approx(0.8 * 3.0 + 0.2 * width)


def test_without_an_empty_frame_the_first_map_is_of_the_box(boxed_sky):
    """Nothing is favoured where it was said that no object is; inside the body is."""
    image = SHARP
    observation = observe(image, boxed_sky, config(), {})
    assert observation.region is not None
    expected = first_region(image.image, 8, boxed_sky.known)
    np.testing.assert_array_equal(observation.region.foreground, expected.foreground)
    assert observation.maps.log_ratio[boxed_sky.known].max() <= -1.0
    assert found(observation.maps.log_ratio) > 0.8
    assert observation.maps.psf_sigma_px is None
    assert np.isfinite(observation.maps.log_background)


def test_later_maps_are_of_what_was_remembered_and_may_leave_the_box(boxed_sky):
    """The object moves out of the box that it was in: the map follows."""
    first = observe(SHARP, boxed_sky, config(), {})
    memory = remember(first, SHARP, {}, True, lambda: BODY)
    moved = picture(2, psf_px=0.4)
    moved = Image(np.roll(moved.image, (-30, -28), axis=(0, 1)), 8, 1)
    later = observe(moved, boxed_sky, config(), memory)
    favoured = np.roll(later.maps.log_ratio, (30, 28), axis=(0, 1))
    assert found(favoured) > 0.75  # the smoothing of the levels alone makes it a pixel wider
    assert later.region is not None
    np.testing.assert_array_equal(later.region.foreground, memory["region_foreground"])


def test_a_tracked_frame_teaches_with_its_best_silhouette(boxed_sky):
    image = SHARP
    observation = observe(image, boxed_sky, config(), {})
    assert observation.region is not None
    memory = remember(observation, image, {}, True, lambda: BODY)
    expected = learn_region(observation.region, image.image, 8, BODY)
    np.testing.assert_array_equal(memory["region_foreground"], expected.foreground)
    np.testing.assert_array_equal(memory["region_background"], expected.background)
    assert np.any(expected.foreground != observation.region.foreground)


def test_a_lost_frame_teaches_nothing_but_keeps_what_was_known(boxed_sky):
    observation = observe(SHARP, boxed_sky, config(), {})
    assert observation.region is not None
    memory = remember(observation, SHARP, {}, False, never)
    np.testing.assert_array_equal(memory["region_foreground"], observation.region.foreground)
    np.testing.assert_array_equal(memory["region_background"], observation.region.background)


def test_what_others_remember_is_kept_and_no_memory_is_changed(boxed_sky, empty_sky):
    """The tracker's own entries pass through; the mapping that came in is left as it was."""
    for sky in (boxed_sky, empty_sky):
        before: Mapping[str, np.ndarray] = {"age": np.array(4.0), "psf_sigma_px": np.array(2.0)}
        observation = observe(picture(7), sky, config(), before)
        after = remember(observation, picture(7), before, True, lambda: BODY)
        assert float(np.asarray(after["age"])) == 4.0
        assert sorted(before) == ["age", "psf_sigma_px"]
        assert float(before["psf_sigma_px"]) == 2.0


def test_the_memory_can_be_stored(boxed_sky):
    """Plain arrays: what is read back gives the same map, bit for bit."""
    memory = remember(observe(SHARP, boxed_sky, config(), {}), SHARP, {}, True, lambda: BODY)
    stored = {
        name: np.frombuffer(np.asarray(value).tobytes(), np.asarray(value).dtype) for name, value in memory.items()
    }
    maps = [observe(picture(2), boxed_sky, config(), m).maps.log_ratio for m in (memory, stored)]
    assert maps[0].tobytes() == maps[1].tobytes()


@pytest.mark.parametrize(("age", "even"), [(0.0, False), (2.0, False), (3.0, True), (9.0, True), (10.0, False)])
def test_the_edge_costs_alike_only_where_a_track_is_followed(empty_sky, age, even):
    """Searches need the unlike prices."""
    log_ratio = observe(picture(7), empty_sky, config(), {"age": np.array(age)}).maps.log_ratio
    edge = ndimage.binary_dilation(log_ratio <= 0) & (log_ratio > 0)  # its pixels touch the dark
    assert (float(log_ratio[edge].max()) < 0.5 + 1.3) == even
