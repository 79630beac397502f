"""A client that leaves in the middle of its body is nobody's error."""

import asyncio

import httpx
import pytest
from api_client import Api, served

pytestmark = pytest.mark.anyio


async def test_leaving_in_the_middle_of_a_body_is_no_error(make_app):
    app = make_app()
    async with served(app) as address, httpx.AsyncClient(base_url=f"http://{address}") as http:
        session_id = await Api(http).ready_session()
        host, port = address.split(":")
        _, writer = await asyncio.open_connection(host, int(port))
        head = f"PUT /v1/sessions/{session_id}/frames/0 HTTP/1.1\r\nHost: {address}\r\nContent-Length: 100\r\n\r\nhalf"
        writer.write(head.encode())
        await writer.drain()
        writer.close()
        await writer.wait_closed()
        seen = app.state.services.metrics.registry.get_sample_value
        labels = {"method": "PUT", "route": "/v1/sessions/{session_id}/frames/{index}"}
        while seen("skypose_request_seconds_count", {**labels, "status": "499"}) is None:
            await asyncio.sleep(0)
            assert seen("skypose_request_seconds_count", {**labels, "status": "500"}) is None
        assert (await http.get(f"/v1/sessions/{session_id}")).json()["frames"] == 0
