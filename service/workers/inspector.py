"""What a body says of itself before it is queued: how many frames, when and where they were taken.

Headers that a few lines of ours read are read here. FITS takes a large library and may be packed, so it goes to a
decode process, which comes up with the first such file.
"""

from __future__ import annotations

import asyncio

from service.imaging.decode import FITS
from service.imaging.facts import FrameFacts
from service.imaging.headers import media_kind
from service.workers.decode_process import DecodeProcess
from service.workers.decoding import Decoder, InPlace
from service.workers.limits import DecodeLimits


class Inspector:
    """For the web process. Both methods raise ``InputError`` for what is wrong with the body."""

    def __init__(self, limits: DecodeLimits) -> None:
        self._here = InPlace(limits)
        self._apart = DecodeProcess(limits)

    async def count(self, body: bytes, media_type: str) -> int | None:
        """Frames in a file; None for a video, which has to be decoded to know."""
        return await asyncio.to_thread(self._decoder(media_type).count, body, media_type)

    async def facts(self, body: bytes, media_type: str) -> FrameFacts:
        """Time and pointing of the first frame."""
        return await asyncio.to_thread(self._decoder(media_type).facts, body, media_type)

    async def require_sandbox(self) -> None:
        """Raise ``WorkerFailedError`` where the settings require a measure that the decode process cannot take."""
        await asyncio.to_thread(lambda: self._apart.sandbox)

    def close(self) -> None:
        """End the decode process."""
        self._apart.close()

    def _decoder(self, media_type: str) -> Decoder:
        return self._apart if media_kind(media_type) in FITS else self._here
