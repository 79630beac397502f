"""Cards added to a FITS file as bytes: every other byte of it stays as it was."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

from astropy.io import fits

from service.imaging.headers import broken

Card = tuple[str, str | float | int, str]  # keyword, value, comment

_BLOCK, _CARD = 2880, 80  # format: FITS
_END = b"END".ljust(_CARD)
_GZIP = b"\x1f\x8b"


def with_cards(body: bytes, cards: Sequence[Card], *, limit: int) -> bytes:
    """The file with ``cards`` at the end of its first header; those of the same keywords are replaced.

    A file in gzip comes back unpacked, of at most ``limit`` bytes. Raises ``ImageError`` for what has no header.
    """
    if body.startswith(_GZIP):
        body = zlib.decompressobj(wbits=31).decompress(body, limit)
    kept, after = _header(body)
    keywords = {f"{keyword:<8}".encode() for keyword, _, _ in cards}
    lines = [line for line in kept if line[:8] not in keywords]
    while lines and not lines[-1].strip():
        lines.pop()
    lines += [fits.Card(*card).image.encode("ascii") for card in cards]
    header = b"".join([*lines, _END])
    return header.ljust(-(-len(header) // _BLOCK) * _BLOCK) + body[after:]


def _header(body: bytes) -> tuple[list[bytes], int]:
    """The cards of the first header without END, and where its last block ends."""
    for end in range(_BLOCK, len(body) + 1, _BLOCK):
        block = [body[at : at + _CARD] for at in range(end - _BLOCK, end, _CARD)]
        if _END in block:
            count = (end - _BLOCK) // _CARD + block.index(_END)
            return [body[at : at + _CARD] for at in range(0, count * _CARD, _CARD)], end
    raise broken("FITS: the header has no end")
