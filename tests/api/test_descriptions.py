"""The descriptions say what the service does: openapi.json word for word, asyncapi.yaml by real events."""

import json
from pathlib import Path
from typing import get_args, get_type_hints

import httpx
import pytest
import websockets
import yaml
from api_client import Api, served
from jsonschema import Draft202012Validator
from referencing import Registry, Resource
from referencing.jsonschema import DRAFT202012

from service.cli.openapi import openapi_text
from service.sessions.hub import Message

DOCS = Path(__file__).resolve().parents[2] / "docs"
ASYNCAPI = DOCS.parent / "service" / "api" / "asyncapi.yaml"
REWRITE = "the API changed; see that it only grew, then: skypose openapi --out docs/openapi.json"


def test_openapi_is_the_frozen_one():
    frozen, now = (DOCS / "openapi.json").read_text().splitlines(), openapi_text().splitlines()
    changed = [(number, *pair) for number, pair in enumerate(zip(frozen, now, strict=False), 1) if pair[0] != pair[1]]
    assert not changed, f"{REWRITE}\nline, frozen, now: {changed[0]}"
    assert len(frozen) == len(now), REWRITE


@pytest.fixture(scope="module")
def registry() -> Registry:
    files = {
        "openapi.json": json.loads((DOCS / "openapi.json").read_text()),
        "asyncapi.yaml": yaml.safe_load(ASYNCAPI.read_text()),
    }
    resources = [(f"http://docs/{name}", Resource(document, DRAFT202012)) for name, document in files.items()]
    return Registry().with_resources(resources)


def refused(registry: Registry, kind: str, document: dict) -> list[str]:
    """What of a message does not fit its schema in asyncapi.yaml."""
    schema = {"$ref": f"http://docs/asyncapi.yaml#/components/messages/{kind}/payload"}
    return [error.message for error in Draft202012Validator(schema, registry=registry).iter_errors(document)]


def test_every_reference_leads_somewhere(registry):
    document = registry.contents("http://docs/asyncapi.yaml")
    resolver = registry.resolver("http://docs/asyncapi.yaml")
    pending, seen = [document], 0
    while pending:
        item = pending.pop()
        if isinstance(item, dict):
            if "$ref" in item:
                assert resolver.lookup(item["$ref"]).contents
                seen += 1
            pending += item.values()
        elif isinstance(item, list):
            pending += item
    assert seen > 10


@pytest.mark.anyio
async def test_events_are_as_asyncapi_says(make_app, registry):
    told: list[dict] = []
    async with served(make_app(stream_heartbeat_s=0.01)) as host, httpx.AsyncClient(base_url=f"http://{host}") as http:
        api = Api(http)
        session_id = await api.ready_session(camera={"up_angle_deg": 20.0})
        async with websockets.connect(f"ws://{host}/v1/sessions/{session_id}/stream?after=9") as socket:

            async def until(kind: str) -> None:
                while not told or told[-1]["type"] != kind:
                    told.append(json.loads(await socket.recv()))

            await until("heartbeat")
            await api.post(session_id, 0, ra_deg=10, dec_deg=20)
            await until("estimate")
            await http.delete(f"/v1/sessions/{session_id}")
            await until("end")
    assert {message["type"] for message in told} == {"estimate", "heartbeat", "resync-required", "end"}
    for message in told:
        assert not refused(registry, message["type"], message)
    broken = {**next(m for m in told if m["type"] == "estimate"), "seq": -1, "more": 1}
    assert len(refused(registry, "estimate", broken)) == 2
    assert refused(registry, "estimate", {**broken, "seq": 1, "estimate": {}})


def test_every_type_of_message_is_described(registry):
    described = set(registry.contents("http://docs/asyncapi.yaml")["components"]["messages"])
    assert described == set(get_args(get_type_hints(Message)["type"]))


@pytest.mark.anyio
async def test_the_stream_is_described_beside_the_rest(api):
    answer = await api.http.get("/asyncapi.yaml")
    assert answer.text == ASYNCAPI.read_text()
    assert answer.headers["content-type"].startswith("application/yaml")
