"""FITS (4.0): images and cubes, plain, tile-compressed (RICE, GZIP, ...) or in gzip; values scaled by BZERO, BSCALE.

FITS counts rows from the bottom; this program, like most cameras, from the top. So rows are turned round, unless the
header says ``ROWORDER = 'TOP-DOWN'``, as capture programs do that write them as the sensor gives them. A third axis
of three is colour, unless CTYPE3 speaks of time; any other is a sequence of frames. A raw colour sensor's mosaic
(BAYERPAT) becomes grey.
"""

from __future__ import annotations

import io
import warnings
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from astropy.io import fits

from service.errors import SkyposeError, TooLargeError
from service.imaging.facts import FrameFacts
from service.imaging.formats.fits_header import read_header_facts
from service.imaging.frame import Frame, as_frame
from service.imaging.headers import broken
from service.imaging.limits import RATIO_FROM_BYTES, ImageLimits
from service.imaging.mosaic import without_mosaic

_GZIP = b"\x1f\x8b"
_BYTES_PER_PIXEL = 8  # numerical: of a decoded one, at the most
_HEADROOM = 1 << 24  # numerical: headers and tables beside the pixels
_TOP_DOWN = "TOP-DOWN"
_MOSAICS = ("RGGB", "BGGR", "GRBG", "GBRG")  # format: values of BAYERPAT
_BLOCK = 2880  # format: FITS
_END = b"END".ljust(80)  # format: FITS
_HEADER_STARTS = (b"SIMPLE  =", b"XTENSION=")


def read_fits(body: bytes, limits: ImageLimits) -> Sequence[Frame]:
    """Every frame of the first image in the file. Raises ``ImageError``, ``TooLargeError``."""
    with _first_image(body, limits) as hdu:
        header, shape = hdu.header, tuple(int(n) for n in hdu.shape)
        colour = _is_colour(shape, header)
        frames = _count(shape, colour)
        limits.require_size(frames, shape[-1], shape[-2])
        data = np.asarray(hdu.data).reshape(frames, *shape[-3 if colour else -2 :])
        images = np.moveaxis(data, 1, -1) if colour else data
        if not _top_down(header):
            images = images[:, ::-1]
        facts, mosaic = _facts(header, shape), not colour and _is_mosaic(header)
        plain = (without_mosaic(image) if mosaic else image for image in images)
        return [as_frame(image, facts if k == 0 else _later(facts)) for k, image in enumerate(plain)]


def read_fits_facts(body: bytes, limits: ImageLimits) -> FrameFacts:
    """Time and pointing of the first frame, from the header alone. Raises as ``read_fits`` does."""
    with _first_image(body, limits) as hdu:
        return _facts(hdu.header, tuple(int(n) for n in hdu.shape))


def count_fits_frames(body: bytes, limits: ImageLimits) -> int:
    """Frames of the first image, from the header alone. Raises as ``read_fits`` does."""
    with _first_image(body, limits) as hdu:
        shape = tuple(int(n) for n in hdu.shape)
        return _count(shape, _is_colour(shape, hdu.header))


@contextmanager
def _first_image(body: bytes, limits: ImageLimits) -> Iterator[Any]:
    """The first HDU that holds an image. Whatever astropy's parser raises is the file's fault."""
    data = _inflated(body, limits) if body.startswith(_GZIP) else body
    if not data.startswith(b"SIMPLE"):
        raise broken("the media type says FITS, but the body does not begin with SIMPLE")
    _require_headers(data, limits)
    try:
        # Its warnings are of odd cards in the header; a file that is cut short is found out below.
        with warnings.catch_warnings(action="ignore"), fits.open(io.BytesIO(data), memmap=False) as hdus:
            yield next(hdu for hdu in _whole(hdus, len(data)) if hdu.is_image and len(hdu.shape) >= 2)
    except (SkyposeError, GeneratorExit):
        raise
    except StopIteration as error:
        raise broken("FITS: the file holds no image") from error
    except Exception as error:
        raise broken(f"FITS: the file cannot be read: {error}") from error


def _whole(hdus: Any, length: int) -> Iterator[Any]:
    """The HDUs one after the other, as far as the file goes."""
    index = 0
    while True:
        try:
            hdu = hdus[index]
        except IndexError:
            return
        info = hdu.fileinfo()
        stored = hdu.size if not isinstance(hdu, fits.CompImageHDU) else info["datSpan"]
        if info["datLoc"] + stored > length:
            raise broken("FITS: the file is cut short")
        yield hdu
        index += 1


def _require_headers(data: bytes, limits: ImageLimits) -> None:
    """Raises ``TooLargeError`` where cards go on and on: each costs the parser more than its 80 bytes."""
    for start in range(0, len(data), _BLOCK):
        if data.startswith(_HEADER_STARTS, start):
            end = data.find(_END, start, start + limits.header_bytes + len(_END))
            if end < 0:
                limits.require_header(len(data) - start)


def _inflated(body: bytes, limits: ImageLimits) -> bytes:
    most = limits.pixels * _BYTES_PER_PIXEL + _HEADROOM
    limit = min(most, max(RATIO_FROM_BYTES, limits.ratio * len(body)) + _HEADROOM)
    inflater = zlib.decompressobj(wbits=31)
    try:
        data = inflater.decompress(body, limit)
    except zlib.error as error:
        raise broken(f"FITS: damaged gzip: {error}") from error
    if inflater.unconsumed_tail:
        setting = "SKYPOSE_MAX_IMAGE_PIXELS" if limit == most else "SKYPOSE_MAX_IMAGE_RATIO"
        raise TooLargeError(f"the file unpacks to more than {limit} bytes", field="body", limit=limit, setting=setting)
    if not inflater.eof:
        raise broken("FITS: the gzip file is cut short")
    return data


def _is_colour(shape: tuple[int, ...], header: fits.Header) -> bool:
    if len(shape) > 4 or (len(shape) == 4 and shape[1] not in (1, 3)):
        raise broken(f"FITS: an image with {len(shape)} axes {shape[::-1]} is unknown")
    return len(shape) >= 3 and shape[-3] == 3 and "TIME" not in str(header.get("CTYPE3", "")).upper()


def _count(shape: tuple[int, ...], colour: bool) -> int:
    return int(np.prod(shape[: -3 if colour else -2], dtype=np.int64))


def _is_mosaic(header: fits.Header) -> bool:
    return str(header.get("BAYERPAT", "")).strip().upper() in _MOSAICS


def _top_down(header: fits.Header) -> bool:
    return str(header.get("ROWORDER", "")).strip().upper() == _TOP_DOWN


def _facts(header: fits.Header, shape: tuple[int, ...]) -> FrameFacts:
    return read_header_facts(header, width=shape[-1], height=shape[-2], top_down=_top_down(header))


def _later(facts: FrameFacts) -> FrameFacts:
    """Of the later frames of a cube: the header tells when the first was taken, and no more."""
    return replace(facts, time=None)
