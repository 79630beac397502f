"""What one tenant has does not exist for another: every route of the OpenAPI document, walked as two tenants."""

import json
import pkgutil
import re
import uuid
from dataclasses import replace
from importlib import import_module

import numpy as np
import orjson
import pytest
from api_client import PNG, image
from callers import guarded
from fake_worker import CUBE

import service.api
from service.sessions.checkpoint import Checkpoint
from service.workers.codec import decode, encode

pytestmark = pytest.mark.anyio
ENDLESS = "/v1/sessions/{session_id}/events"
CHECKPOINT = "/v1/sessions/{session_id}/checkpoint"
MARK = "of-acme-only"
READS_THAT_CHANGE = {"/metrics", "/v1/system", "/v1/audit", "/v1/keys", "/v1/me"}  # counters, times
PUBLIC = {"/healthz", "/readyz"}


class Owned:
    """Everything that a tenant can have, and how its parts are named in paths."""

    def __init__(self, api, ids, checkpoint):
        self.api, self.ids, self.checkpoint = api, ids, checkpoint


async def own(callers, tenant: str, mark: str, model: bytes) -> Owned:
    api = await callers.client(tenant, name=mark)
    session_id = await api.ready_session(model, name=mark)
    for n in range(2):
        assert (await api.post(session_id, n, {"Idempotency-Key": f"{mark}{n}"})).status_code == 200
    session = (await api.http.get(f"/v1/sessions/{session_id}")).json()
    key = (await api.http.post("/v1/keys", json={"role": "read", "name": mark})).json()
    made = (await api.http.post("/v1/objects", json={"name": mark, "sessions": [session_id]})).json()
    ids = {
        "session_id": session_id,
        "object_id": made["object_id"],
        "model_id": session["model_id"],
        "key_id": key["id"],
        "caller_id": (await api.http.get("/v1/me")).json()["key_id"],
        "index": "1",
        "key": f"{mark}1",
    }
    checkpoint = (await api.http.get(f"/v1/sessions/{session_id}/checkpoint")).content
    return Owned(api, ids, checkpoint)


def unknown_ids(ids: dict[str, str]) -> dict[str, str]:
    """As those, of things that never were."""
    made_up = {"session_id": str(uuid.uuid4()), "model_id": uuid.uuid4().hex, "key_id": uuid.uuid4().hex[:8]}
    return {**ids, **made_up, "object_id": str(uuid.uuid4())}


def body(method: str, path: str, ids: dict[str, str], checkpoint: bytes) -> dict:
    """A body that the route would take."""
    if method in ("get", "delete"):
        return {}
    if path == "/v1/models":
        return {"files": {"file": ("cube.glb", CUBE + b"walk")}}
    if path == "/v1/sessions":
        return {"json": {"model_id": ids["model_id"]}}
    if path == "/v1/keys":
        return {"json": {"role": "read", "name": "walk"}}
    if path == "/v1/objects":
        return {"json": {"name": "walk", "sessions": [ids["session_id"]]}}
    if path.endswith("/checkpoint"):
        return {"content": checkpoint, "headers": {"Content-Type": "application/vnd.skypose.checkpoint"}}
    return {"content": image(7), "headers": PNG}


async def routes(api) -> list[tuple[str, str]]:
    paths = (await api.http.get("/openapi.json")).json()["paths"]
    return [(method, path) for path, methods in paths.items() for method in methods]


def masked(text: str, ids: dict[str, str]) -> str:
    """Without what the caller itself named, and what differs from call to call."""
    for value in (ids["session_id"], ids["object_id"], ids["model_id"], ids["key_id"]):
        text = text.replace(value, "<id>")
    text = re.sub(r'"(created_at|updated_at|at|ticket|key|id|last_used_at|uptime_s)":("[^"]*"|[\d.]+)', r'"\1":0', text)
    return re.sub(r"[0-9a-f]{8}-[0-9a-f-]{27}", "<uuid>", text)


async def call(api, method: str, path: str, ids: dict[str, str], checkpoint: bytes):
    return await api.http.request(method, path.format(**ids), **body(method, path, ids, checkpoint))


async def test_every_route_as_two_tenants_leaks_nothing(make_app, tmp_path):
    """For each route with the ids of another tenant: the answer is the one that ids get which never were."""
    async with guarded(make_app, tmp_path) as callers:
        acme = await own(callers, "acme", MARK, CUBE + b"acme")
        other = await own(callers, "other", "mine", CUBE + b"other")
        before = await snapshot(acme)
        leaks, walked = [], await routes(other.api)
        # Last: it makes a session of that id, the caller's own.
        for method, path in sorted(walked, key=lambda route: route == ("put", CHECKPOINT)):
            await callers.app.state.services.audit.store(final=True)
            foreign = await call(other.api, method, path, acme.ids, other.checkpoint)
            nobody = unknown_ids(acme.ids)
            unknown = await call(other.api, method, path, nobody, other.checkpoint)
            same = (foreign.status_code, masked(foreign.text, acme.ids)) == (
                unknown.status_code,
                masked(unknown.text, nobody),
            )
            if (not same and "{" in path) or foreign.status_code >= 500:
                leaks.append((method, path, foreign.status_code, unknown.status_code, foreign.text[:300]))
            named = "{" in path or path == "/v1/objects"  # acme's ids by the caller itself
            shown = masked(foreign.text, acme.ids) if named else foreign.text
            shown = re.sub(r'"target":"[^"]*"', "", shown)  # in its own audit log: the ids that it tried itself
            if MARK in shown.replace(acme.ids["key"], "") or (
                "{" not in path and any(acme.ids[name] in shown for name in ("session_id", "key_id", "caller_id"))
            ):
                leaks.append((method, path, "shows what is acme's", foreign.text[:300]))
        print(f"{len(walked)} routes as two tenants: {len(leaks)} leaks")
        assert not leaks
        assert len(walked) > 25
        assert await snapshot(acme) == before


async def snapshot(owned: Owned) -> dict[str, bytes]:
    """All that a tenant can read of its own."""
    found = {}
    for method, path in await routes(owned.api):
        if method == "get" and path != ENDLESS and path not in READS_THAT_CHANGE | PUBLIC:
            answer = await call(owned.api, method, path, owned.ids, b"")
            assert answer.status_code in (200, 409), (path, answer.text)  # 409: no FITS, no attitude
            found[path] = re.sub(rb"[^>]*( by skypose)", rb"\1", answer.content)  # when a report was made
    keys = json.loads((await owned.api.http.get("/v1/keys")).content)["keys"]
    found["keys"] = [(key["id"], key["revoked_at"]) for key in keys]
    assert len(found) > 12
    return found


async def test_every_route_asks_for_a_credential(make_app, tmp_path):
    async with guarded(make_app, tmp_path) as callers:
        nobody = await callers.with_token(None)
        wrong = await callers.with_token("skypose_00000000_" + "A" * 43)
        for method, path in await routes(nobody):
            for api in (nobody, wrong):
                answer = await call(api, method, path, unknown_ids({"index": "0", "key": "k"}), b"")
                if path in PUBLIC:
                    assert answer.status_code == 200
                else:
                    assert answer.status_code == 401, (method, path, answer.text)
                    assert answer.json()["type"] == "urn:skypose:problem:unauthorized"
                    assert answer.headers["www-authenticate"].startswith("Bearer")


async def test_roles(make_app, tmp_path):
    """`read` changes nothing, `operate` makes no keys."""
    async with guarded(make_app, tmp_path) as callers:
        reader, operator = await callers.client("acme", "read"), await callers.client("acme", "operate")
        ids = unknown_ids({"index": "0", "key": "k"})
        for method, path in await routes(reader):
            admins = path.startswith(("/v1/keys", "/v1/audit"))
            for api, allowed in ((reader, method == "get" or path == "/v1/tickets"), (operator, True)):
                answer = await call(api, method, path, ids, b"")
                expected = allowed and not admins and path != "/metrics"  # which is the operator's tenant's
                assert (answer.status_code != 403) == expected, (method, path, answer.text)
                if not expected:
                    assert answer.json()["needs"] in ("operate", "admin", "default")


async def test_same_content_and_same_id_twice(make_app, tmp_path):
    """Two tenants hold the same model and a session of the same id, and neither notices the other."""
    async with guarded(make_app, tmp_path) as callers:
        acme, other = await callers.client("acme"), await callers.client("other")
        first = [await api.model(CUBE + b"same") for api in (acme, other)]
        assert [answer.status_code for answer in first] == [201, 201]
        session_id = await acme.ready_session(CUBE + b"same", name="acme's")
        await acme.post(session_id, 1)
        blob = (await acme.http.get(f"/v1/sessions/{session_id}/checkpoint")).content
        assert b"acme/" not in blob
        answer = await other.http.put(f"/v1/sessions/{session_id}/checkpoint", content=blob)
        assert (answer.status_code, answer.json()["session_id"]) == (201, session_id)
        here = f"/v1/sessions/{session_id}"
        assert (await other.post(session_id, 2)).status_code == 200
        assert [(await api.http.get(here)).json()["frames"] for api in (acme, other)] == [1, 2]
        assert (await other.http.delete(here)).status_code == 204
        model_id = first[0].json()["model_id"]
        assert (await other.http.delete(f"/v1/models/{model_id}")).status_code == 204
        assert (await acme.post(session_id, 2)).status_code == 200
        assert (await acme.http.get(f"/v1/models/{model_id}/mesh.glb")).status_code == 200


async def test_ids_cannot_name_another_tenants_rows(make_app, tmp_path):
    """Not even the default tenant, whose keys have no prefix, by writing one."""
    async with guarded(make_app, tmp_path) as callers:
        acme, root = await callers.client("acme"), await callers.client("default")
        session_id = await acme.session()
        model_id = (await acme.http.get("/v1/models")).json()["models"][0]["model_id"]
        for path in (f"/v1/sessions/acme%2F{session_id}", f"/v1/models/acme%2F{model_id}"):
            assert (await root.http.get(path)).status_code == 404
        answer = await root.http.post("/v1/sessions", json={"model_id": f"acme/{model_id}"})
        assert answer.status_code == 404
        for body in ({"model_id": model_id}, {"model_ids": [model_id, "0" * 32]}):
            assert (await root.http.post("/v1/sessions", json=body)).status_code == 404


@pytest.mark.parametrize(
    "crafted",
    [
        {"tenant": "acme"},
        {"model_ids": ["acme/model"]},
        {"number": 1},
        {"epoch": 99},
        {"background_key": "0" * 64},  # of another's background, or of one to come
    ],
)
async def test_a_crafted_checkpoint_names_no_rows_of_others(make_app, tmp_path, crafted):
    async with guarded(make_app, tmp_path) as callers:
        other = await callers.client("other")
        session_id = await other.ready_session()
        here = f"/v1/sessions/{session_id}/checkpoint"
        found = decode(Checkpoint, (await other.http.get(here)).content)
        session = {**orjson.loads(found.session.tobytes()), **crafted}
        blob = encode(replace(found, session=np.frombuffer(orjson.dumps(session), np.uint8)))
        answer = await other.http.put("/v1/sessions/new/checkpoint", content=blob)
        assert (answer.status_code, answer.json()["type"]) == (422, "urn:skypose:problem:broken-checkpoint")
        assert (await other.http.get("/v1/sessions/new")).status_code == 404


def test_what_the_description_leaves_out_tells_nothing(make_app):
    """Routes that are not in the OpenAPI document: the stream, tested for itself, and the same for everybody."""
    app = make_app()
    modules = [import_module(f"service.api.{found.name}") for found in pkgutil.iter_modules(service.api.__path__)]
    routers = [app.router, *(module.router for module in modules if hasattr(module, "router"))]
    found = [route for router in routers for route in router.routes if hasattr(route, "path")]
    paths = {getattr(route, "path_format", route.path) for route in found}
    assert len(paths) > 25
    hidden = paths - set(app.openapi()["paths"])
    assert hidden == {
        *("/", "/docs", "/openapi.json", "/asyncapi.yaml", "/static/{path}"),
        "/v1/sessions/{session_id}/stream",
    }
