"""Cards added to a file: all else stays, byte by byte."""

import gzip
import io

import numpy as np
import pytest
from astropy.io import fits

from service.errors import ImageError
from service.imaging.formats.fits_cards import with_cards

LIMIT = 1 << 24
CARDS = [("POSE_QW", 0.123456789012, "body -> camera"), ("POSE_STA", "tracking", "status")]


def written(kind=fits.PrimaryHDU, n_cards: int = 0) -> bytes:
    hdu = kind(np.arange(200, dtype=np.uint16).reshape(10, 20))
    for k in range(n_cards):
        hdu.header[f"CARD{k}"] = k
    stream = io.BytesIO()
    fits.HDUList([hdu] if kind is fits.PrimaryHDU else [fits.PrimaryHDU(), hdu]).writeto(stream)
    return stream.getvalue()


@pytest.mark.parametrize("n_cards", [0, 26, 27, 28, 29, 30])  # around the end of a block
@pytest.mark.parametrize("packed", [bytes, gzip.compress])
def test_everything_else_stays(n_cards, packed):
    body = written(n_cards=n_cards)
    found = with_cards(packed(body), CARDS, limit=LIMIT)
    assert len(found) % 2880 == 0
    before, after = fits.Header.fromstring(body.decode("latin1")), fits.Header.fromstring(found.decode("latin1"))
    assert [str(card) for card in after.cards][: len(before)] == [str(card) for card in before.cards]
    assert found[-2880:] == body[-2880:]  # the pixels
    assert (after["POSE_QW"], after["POSE_STA"]) == (0.123456789012, "tracking")


def test_cards_of_an_earlier_pose_are_replaced():
    once = with_cards(written(), CARDS, limit=LIMIT)
    assert with_cards(once, CARDS, limit=LIMIT) == once


def test_compressed_images_keep_their_table():
    body = written(fits.CompImageHDU)
    with fits.open(io.BytesIO(with_cards(body, CARDS, limit=LIMIT))) as hdus:
        assert hdus[0].header["POSE_STA"] == "tracking"
        assert hdus[1].data[3, 4] == 64


def test_what_has_no_end_is_refused():
    with pytest.raises(ImageError):
        with_cards(written()[:2000], CARDS, limit=LIMIT)
