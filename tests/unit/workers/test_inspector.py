"""What a body says of itself: FITS is read by tenants in turn, apart from all else."""

import asyncio
import io

import numpy as np
import pytest
from astropy.io import fits

from service.errors import ImageError
from service.workers.inspector import Inspector
from service.workers.limits import DecodeLimits

pytestmark = pytest.mark.anyio


async def test_a_tenant_does_not_wait_for_all_of_another():
    stream, order = io.BytesIO(), []
    fits.PrimaryHDU(np.zeros((2, 4, 5), np.uint8)).writeto(stream)
    inspector = Inspector(DecodeLimits())

    async def count(tenant: str, body: bytes) -> int | None:
        try:
            return await inspector.count(tenant, body, "image/fits")
        finally:
            order.append(tenant)

    try:
        assert await count("good", stream.getvalue()) == 2  # the first file also loads what reads it
        order.clear()
        *refused, frames = await asyncio.gather(
            *(count("hostile", b"SIMPLE  = no") for _ in range(6)),
            count("good", stream.getvalue()),
            return_exceptions=True,
        )
    finally:
        inspector.close()
    assert frames == 2 and all(isinstance(error, ImageError) for error in refused)
    assert order == ["hostile", "good", *["hostile"] * 5]
