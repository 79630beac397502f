"""What ``skypose bench sky`` measures, and passes on a larger canvas or cut off at an edge."""

from dataclasses import replace

import numpy as np
import pytest

from service.bench.brightness import pixels
from service.bench.canvas import framed, on_canvas
from service.bench.cut import cut_off
from service.bench.early import begun_early
from service.bench.folder import SequenceError
from service.bench.guided import by_hand
from service.bench.sky_bench import bench_sky, sky_document, sky_table
from service.simulate.folder import encode_png


@pytest.mark.parametrize("frames", [0, 3])
def test_a_sky_is_told_at_every_size(frames):
    rows = bench_sky((200, 900), (frames,), 1)
    assert [(row.side_px, row.frames) for row in rows] == [(200, frames), (900, frames)]
    assert all(row.learn_ms > 0 and row.derive_ms > 0 for row in rows)
    assert max(row.level_error for row in rows) < 0.6
    assert max(abs(row.noise_error) for row in rows) < 0.03
    document = sky_document({"cpu": "x"}, rows)
    assert document["rows"][0]["side_px"] == 200
    assert sky_table(rows).row_count == 2


@pytest.mark.parametrize(("dtype", "shape"), [(np.uint8, (40, 60)), (np.uint16, (40, 60)), (np.uint8, (40, 60, 3))])
def test_sky_and_noise_of_an_image_go_on_about_it(dtype, shape):
    rng = np.random.default_rng(0)
    image = np.rint(rng.normal(60, 4, shape)).astype(dtype)
    image[15:25, 20:40] = 200
    whole = pixels(framed(encode_png(image), 300, (1, 0)))
    assert whole.dtype == dtype and whole.shape == (300, 300, *shape[2:])
    np.testing.assert_array_equal(whole[130:170, 120:180], image)
    assert whole[:100].mean() == pytest.approx(60, abs=1.5) and whole[:100].std() == pytest.approx(4, rel=0.2)


def test_a_pass_moves_with_its_frames(case_of, satellite, truth):
    empty = encode_png(np.full((64, 64), 9, np.uint8))
    case = replace(case_of(satellite), backgrounds=lambda: [empty], frames=lambda: iter([(empty, truth)]))
    wide = on_canvas(replace(case, box=(10.0, 12.0, 20.0, 30.0)), 400)
    (body, moved), (again, _) = next(wide.frames()), next(wide.frames())
    assert wide.size == (400, 400) and pixels(body).shape[:2] == (400, 400) and again == body
    np.testing.assert_allclose(moved.position - truth.position, 168)
    assert wide.box == (178, 180, 20, 30)
    assert [pixels(one).shape for one in wide.backgrounds()] == [(400, 400)]
    with pytest.raises(SequenceError, match="larger than a canvas of 8 px"):
        on_canvas(case, 8)


def test_a_pass_that_is_guided_by_hand(case_of, satellite, truth):
    """Every frame is moved by its own, the truth with it; the body stays within."""
    image = np.random.default_rng(0).integers(0, 99, (200, 160), np.uint8)
    at = replace(truth, position=np.array([30.0, 100.0]), scale=20.0 / satellite.mesh.radius)
    case = replace(case_of(satellite), size=(160, 200), frames=lambda: iter([(encode_png(image), at)] * 12))
    moves = []
    for body, told in by_hand(case, 40).frames():
        moves.append(told.position - at.position)
        moved = np.roll(image, moves[-1][::-1].astype(int), (0, 1))
        np.testing.assert_array_equal(pixels(body), moved)
        assert told.position[0] >= 22 and (told.position <= [138, 178]).all() and np.abs(moves[-1]).max() <= 40
    assert len(np.unique(moves, axis=0)) > 10
    repeated = [told.position - at.position for _, told in by_hand(case, 40).frames()]
    np.testing.assert_array_equal(repeated, moves)


def test_a_pass_whose_frames_begin_before_the_body_comes(case_of, satellite, truth):
    """Its own empty frames, that tell its sky no more."""
    images = [encode_png(np.full((64, 64), k, np.uint8)) for k in range(6)]
    seen = [(images[4 + k], replace(truth, time_s=3.0 + 0.5 * k)) for k in range(2)]
    case = replace(case_of(satellite), backgrounds=lambda: images[:4], frames=lambda: iter(seen))
    early = begun_early(case, 3)
    assert list(early.backgrounds()) == images[3:4]
    told = [truth for _, truth in early.frames()]
    assert [body for body, _ in early.frames()] == [*images[:3], *images[4:]]
    assert [one.visible for one in told] == [False] * 3 + [True] * 2
    np.testing.assert_allclose([one.time_s for one in told], 3.0 + 0.5 * np.arange(5))
    with pytest.raises(SequenceError, match="4 empty frames"):
        begun_early(case, 4)


def test_a_pass_of_which_the_edge_cuts_the_body(case_of, satellite, truth):
    """Images end where a share of its diameter lies below them; no truth is moved by that."""
    image = np.random.default_rng(0).integers(0, 99, (200, 64), np.uint8)
    at = replace(truth, position=np.array([30.0, 100.0]), scale=20.0 / satellite.mesh.radius)
    case = replace(
        case_of(satellite),
        size=(64, 200),
        backgrounds=lambda: [encode_png(image)],
        frames=lambda: iter([(image_of, at)]),
    )
    image_of = encode_png(image)
    for share, rows in ((0.5, 100), (0.25, 110), (0.0, 120)):
        cut = cut_off(case, share)
        body, told = next(cut.frames())
        assert cut.size == (64, rows) and told is at
        np.testing.assert_array_equal(pixels(body), image[:rows])
        assert [pixels(one).shape for one in cut.backgrounds()] == [(rows, 64)]
    above = replace(at, position=np.array([30.0, -100.0]))
    with pytest.raises(SequenceError, match="nothing of the image"):
        cut_off(replace(case, frames=lambda: iter([(image_of, above)])), 0.1)
