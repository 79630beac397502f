"""What generators of clients need: names that are short and unique, and a media type that they know."""

from collections import Counter

import pytest
from api_client import PNG, image

pytestmark = pytest.mark.anyio


async def test_names_are_short_and_unique(api):
    document = (await api.http.get("/openapi.json")).json()
    titles = Counter(schema.get("title", name) for name, schema in document["components"]["schemas"].items())
    assert max(titles.values()) == 1 and not any("__" in name for name in document["components"]["schemas"])
    operations = [one["operationId"] for path in document["paths"].values() for one in path.values()]
    assert max(Counter(operations).values()) == 1
    assert {"create_session", "post_frame", "put_frame", "add_background", "create_key"} <= set(operations)


async def test_every_body_can_be_sent_in_a_form_that_generators_know(api):
    known = {"application/json", "application/octet-stream", "multipart/form-data"}
    document = (await api.http.get("/openapi.json")).json()
    for path in document["paths"].values():
        for operation in path.values():
            content = operation.get("requestBody", {}).get("content", {})
            assert not content or known & set(content), operation["operationId"]


async def test_a_body_of_any_kind_is_what_it_begins_as(api):
    session_id = await api.session()
    url, octets = f"/v1/sessions/{session_id}", {"Content-Type": "application/octet-stream"}
    assert (await api.http.post(f"{url}/background", content=image(), headers=octets)).status_code == 200
    first = await api.http.put(f"{url}/frames/0", content=image(1), headers=octets)
    again = await api.http.put(f"{url}/frames/0", content=image(1), headers=PNG)
    assert first.status_code == 200 and again.json()["duplicate"] is True
    odd = await api.http.post(f"{url}/frames", content=b"no image at all", headers=octets)
    assert (odd.status_code, odd.json()["type"]) == (415, "urn:skypose:problem:unsupported-media-type")
