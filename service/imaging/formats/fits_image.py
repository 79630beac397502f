"""An image as a new FITS file."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from astropy.io import fits

from service.imaging.formats.fits_cards import Card
from service.imaging.frame import Pixels


def fits_of_image(image: Pixels, time: str, cards: Sequence[Card]) -> bytes:
    """FITS 4.0 bytes of (H, W) or (H, W, 3) pixels, rows from the bottom, colours along the third axis.

    ``time``: middle of the exposure, ISO 8601 with Z, as ``DATE-AVG``.
    """
    rows = image[::-1]
    data = rows if image.ndim == 2 else np.moveaxis(rows, 2, 0)
    primary = fits.PrimaryHDU(np.ascontiguousarray(data))
    primary.header["DATE-AVG"] = (time.removesuffix("Z"), "middle of the exposure")
    primary.header["TIMESYS"] = "UTC"
    for card in cards:
        primary.header.append(card)
    file = io.BytesIO()
    primary.writeto(file)
    return file.getvalue()
