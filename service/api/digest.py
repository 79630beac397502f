"""SHA-256 of bodies, the large ones beside the event loop."""

from __future__ import annotations

import asyncio
import hashlib

HASH_IN_LOOP_BYTES = 1 << 16


async def sha256(body: bytes) -> str:
    """In hexadecimal."""
    if len(body) <= HASH_IN_LOOP_BYTES:
        return hashlib.sha256(body).hexdigest()
    return (await asyncio.to_thread(hashlib.sha256, body)).hexdigest()
