"""What a body says of itself before it is queued: how many frames, when and where they were taken.

Headers that a few lines of ours read are read here. FITS takes a large library and may be packed, so it goes to a
decode process, which comes up with the first such file.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TypeVar

from service.imaging.decode import FITS
from service.imaging.facts import FrameFacts
from service.imaging.headers import media_kind
from service.workers.decode_process import DecodeProcess
from service.workers.decoding import InPlace
from service.workers.fair_queue import SEEN, FairQueue
from service.workers.limits import DecodeLimits

R = TypeVar("R")


class Inspector:
    """For the web process. ``count`` and ``facts`` raise ``InputError`` for what is wrong with the body.

    FITS files wait for the decode process by tenants, and for nothing that others of the web process wait for.
    """

    def __init__(self, limits: DecodeLimits) -> None:
        self._here = InPlace(limits)
        self._apart = DecodeProcess(limits)
        self._queue = FairQueue(SEEN)
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="inspector")

    async def count(self, tenant: str, body: bytes, media_type: str) -> int | None:
        """Frames in a file; None for a video, which has to be decoded to know."""
        if media_kind(media_type) in FITS:
            return await self._in_turn(tenant, self._apart.count, body, media_type)
        return await asyncio.to_thread(self._here.count, body, media_type)

    async def facts(self, tenant: str, body: bytes, media_type: str) -> FrameFacts:
        """Time and pointing of the first frame."""
        if media_kind(media_type) in FITS:
            return await self._in_turn(tenant, self._apart.facts, body, media_type)
        return await asyncio.to_thread(self._here.facts, body, media_type)

    async def require_sandbox(self) -> None:
        """Raise ``WorkerFailedError`` where the settings require a measure that the decode process cannot take."""
        await asyncio.to_thread(lambda: self._apart.sandbox)

    def close(self) -> None:
        """End the decode process."""
        self._apart.close()
        self._thread.shutdown()

    async def _in_turn(self, tenant: str, look: Callable[[bytes, str], R], body: bytes, media_type: str) -> R:
        in_thread = partial(asyncio.get_running_loop().run_in_executor, self._thread)
        return await self._queue.run(
            tenant, partial(in_thread, lambda: self._apart.sandbox), partial(in_thread, look, body, media_type)
        )
