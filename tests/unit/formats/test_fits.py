"""FITS as astropy writes it: pixels, rows, time, pointing."""

import gzip
import io
from datetime import UTC, datetime

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.wcs import WCS

from service.errors import ImageError, TooLargeError
from service.imaging.decode import ImageLimits, decode_frame, decode_frames, read_facts

FITS = "image/fits"
NOISE = np.random.default_rng(5)
DEEP = NOISE.integers(0, 65536, (40, 50), dtype=np.uint16)


def written(data, header: dict | None = None, kind=fits.PrimaryHDU, **options) -> bytes:
    hdu = kind(data, **options)
    hdu.header.update(header or {})
    stream = io.BytesIO()
    hdus = [hdu] if kind is fits.PrimaryHDU else [fits.PrimaryHDU(), hdu]
    fits.HDUList(hdus).writeto(stream)
    return stream.getvalue()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_cameras_integers_come_back_exactly(dtype):
    image = NOISE.integers(0, np.iinfo(dtype).max, (30, 20), dtype=dtype, endpoint=True)
    frame = decode_frame(written(image[::-1]), FITS)  # FITS begins with the lowest row
    np.testing.assert_array_equal(frame.image, image)
    assert (frame.bits, frame.channels) == (np.dtype(dtype).itemsize * 8, 1)
    assert frame.image.flags.c_contiguous and frame.image.dtype.isnative


def test_rows_that_are_top_down_stay():
    frame = decode_frame(written(DEEP, {"ROWORDER": "TOP-DOWN"}), "application/fits")
    np.testing.assert_array_equal(frame.image, DEEP)


@pytest.mark.parametrize("pattern", ["RGGB", "GBRG"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_raw_mosaic_becomes_the_mean_of_its_filters(pattern, dtype):
    """However its rows are counted; and so finely that eight bits do not step."""
    x, y = np.meshgrid(np.linspace(0.2, 0.7, 50), np.linspace(0.1, 0.3, 40))
    filters = np.tile([[0.5, 1.0], [1.0, 0.3]], (20, 25))
    light = np.iinfo(dtype).max * (x + y)
    frame = decode_frame(written((light * filters).astype(dtype), {"BAYERPAT": pattern, "ROWORDER": "TOP-DOWN"}), FITS)
    assert (frame.bits, frame.channels) == (16, 1)
    off = frame.image / 65_535 / (0.7 * (x + y))
    assert np.abs(off - 1)[2:-2, 2:-2].max() < 0.02
    plain = decode_frame(written((light * filters).astype(dtype), {"BAYERPAT": "", "ROWORDER": "TOP-DOWN"}), FITS)
    np.testing.assert_array_equal(plain.image, (light * filters).astype(dtype))


@pytest.mark.parametrize("compression", ["RICE_1", "GZIP_1", "GZIP_2"])
def test_compressed_tiles(compression):
    body = written(DEEP[::-1], kind=fits.CompImageHDU, compression_type=compression)
    np.testing.assert_array_equal(decode_frame(body, FITS).image, DEEP)


def test_gzip():
    np.testing.assert_array_equal(decode_frame(gzip.compress(written(DEEP[::-1])), FITS).image, DEEP)


def test_scaled_signed_and_floating_values_become_counts():
    counts = np.array([[0, 1, 300], [4000, 50_000, 65_535]])
    scaled = fits.PrimaryHDU(counts.astype(np.float64)[::-1])
    scaled.scale("int32", bscale=0.5, bzero=1000)
    stream = io.BytesIO()
    scaled.writeto(stream)
    noisy = counts[::-1].astype(np.float32)
    noisy[0, 0] = np.nan
    shares = counts[::-1] / 65_535
    for body in (stream.getvalue(), written(counts[::-1].astype(np.int32)), written(shares.astype(np.float64))):
        np.testing.assert_array_equal(decode_frame(body, FITS).image, counts)
    np.testing.assert_array_equal(decode_frame(written(noisy), FITS).image[1], [0, 50_000, 65_535])
    np.testing.assert_array_equal(decode_frame(written(np.array([[-5, 7]], np.int16)), FITS).image, [[0, 7]])
    with pytest.raises(ImageError, match="16 bits hold"):
        decode_frame(written(np.array([[70_000]], np.int32)), FITS)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_image_without_a_number_is_refused(value):
    with pytest.raises(ImageError, match="no pixel is a number"):
        decode_frame(written(np.full((4, 5), value, np.float32)), FITS)


def test_cubes_are_frames_and_three_planes_are_colour():
    cube = NOISE.integers(0, 65536, (4, 10, 12), dtype=np.uint16)
    frames = decode_frames(written(cube[:, ::-1]), FITS)
    np.testing.assert_array_equal([frame.image for frame in frames], cube)
    (colour,) = decode_frames(written(cube[:3, ::-1]), FITS)
    np.testing.assert_array_equal(colour.image, np.moveaxis(cube[:3], 0, -1))
    assert len(decode_frames(written(cube[:3], {"CTYPE3": "TIME"}), FITS)) == 3
    with pytest.raises(ImageError, match="holds 4 frames"):
        decode_frame(written(cube), FITS)


@pytest.mark.parametrize("share", [0.001, 0.3, 0.9])
@pytest.mark.parametrize("packed", [bytes, gzip.compress])
def test_a_file_cut_short_is_refused(share, packed):
    large = np.tile(DEEP, (5, 5))  # more than the padding of the last block
    for body in (written(large), written(large, kind=fits.CompImageHDU)):
        whole = packed(body)
        with pytest.raises(ImageError):
            decode_frame(whole[: int(share * len(whole))], FITS)


def test_limits_hold_before_anything_is_unpacked():
    claimed = written(np.zeros((4, 4), np.uint8)).replace(
        b"NAXIS1  =                    4", b"NAXIS1  =            400000000"
    )
    with pytest.raises((TooLargeError, ImageError)):
        decode_frame(claimed, FITS)
    with pytest.raises(TooLargeError):
        decode_frame(written(DEEP), FITS, limits=ImageLimits(pixels=1999))
    with pytest.raises(TooLargeError, match="unpacks"):
        decode_frame(gzip.compress(bytes(1 << 25)), FITS, limits=ImageLimits(pixels=10))


def test_small_gzip_files_do_not_unpack_to_large_ones():
    bomb = gzip.compress(written(DEEP) + bytes(90 << 20))
    with pytest.raises(TooLargeError) as refused:
        decode_frame(bomb, FITS)
    assert refused.value.facts["setting"] == "SKYPOSE_MAX_IMAGE_RATIO"
    assert decode_frame(bomb, FITS, limits=ImageLimits(ratio=1000)).image.shape == DEEP.shape


@pytest.mark.parametrize(
    "body", [b"SIMPLE", b"SIMPLE  =                    T" + b" " * 5000, b"\x1f\x8bjunk", b"hello", b""]
)
def test_what_is_no_fits_is_refused(body):
    with pytest.raises(ImageError):
        decode_frame(body, FITS)


def test_a_table_is_no_image():
    stream = io.BytesIO()
    fits.HDUList([fits.PrimaryHDU(), fits.BinTableHDU(np.zeros(3, [("a", "i4")]))]).writeto(stream)
    with pytest.raises(ImageError, match="no image"):
        decode_frame(stream.getvalue(), FITS)


@pytest.mark.parametrize(
    ("cards", "expected"),
    [
        ({"DATE-OBS": "2026-11-20T03:04:05.5", "EXPTIME": 0.5}, datetime(2026, 11, 20, 3, 4, 5, 750_000, UTC)),
        ({"DATE-OBS": "2026-11-20", "TIME-OBS": "03:04:05"}, datetime(2026, 11, 20, 3, 4, 5, 0, UTC)),
        (
            {"DATE-OBS": "2026-11-20T03:04:05", "DATE-AVG": "2026-11-20T03:04:06", "EXPTIME": 9.0},
            datetime(2026, 11, 20, 3, 4, 6, 0, UTC),
        ),
        ({"DATE-OBS": "2026-11-20T03:04:05", "TIMESYS": "TAI"}, None),
        ({}, None),
    ],
)
def test_time_is_the_middle_of_the_exposure(cards, expected):
    body = written(DEEP, cards)
    assert read_facts(body, FITS).time == expected == decode_frame(body, FITS).facts.time


def test_a_date_that_is_none_is_refused():
    with pytest.raises(ImageError, match="DATE-OBS"):
        read_facts(written(DEEP, {"DATE-OBS": "yesterday"}), FITS)


@pytest.mark.parametrize(
    ("cards", "ra", "dec"),
    [
        ({"RA": 150.25, "DEC": -30.5}, 150.25, -30.5),
        ({"OBJCTRA": "10 01 00", "OBJCTDEC": "-30 30 00"}, 150.25, -30.5),
        ({"RA": "10:01:00.0", "DEC": "-00:30:00"}, 150.25, -0.5),
        ({"RA": "10h01m00s", "DEC": "+30d30m00s"}, 150.25, 30.5),
    ],
)
def test_what_the_mount_told(cards, ra, dec):
    facts = read_facts(written(DEEP, {**cards, "POSANGLE": 12.5, "EQUINOX": 2026.9}), FITS)
    assert (facts.ra_deg, facts.dec_deg) == (pytest.approx(ra), pytest.approx(dec))
    assert (facts.position_angle_deg, facts.equinox, facts.mirrored) == (12.5, "date", None)


@pytest.mark.parametrize("top_down", [False, True])
@pytest.mark.parametrize("east_left", [True, False])
def test_a_solved_image_tells_direction_rotation_parity_and_scale(top_down, east_left):
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = ["RA---TAN", "DEC--TAN"]
    wcs.wcs.crval, wcs.wcs.crpix = [83.6, -5.4], [10.0, 31.0]
    turn = np.deg2rad(35.0)
    scale = 2.0 / 3600
    flip = np.diag([-1.0 if east_left else 1.0, 1.0])
    wcs.wcs.cd = scale * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ flip
    header = wcs.to_header()
    if top_down:
        header["ROWORDER"] = "TOP-DOWN"
    facts = read_facts(written(DEEP, dict(header)), FITS)
    centre = wcs.pixel_to_world(24.5, 19.5)
    assert centre.separation(SkyCoord(facts.ra_deg * u.deg, facts.dec_deg * u.deg)).arcsec < 1e-6
    above = wcs.pixel_to_world(24.5, 19.5 + (-1 if top_down else 1))
    assert facts.position_angle_deg == pytest.approx(centre.position_angle(above).to_value(u.deg), abs=1e-3)
    assert facts.mirrored is (top_down == east_left)
    assert facts.pixel_scale_deg == pytest.approx(scale, rel=1e-6)
