"""Keys, tickets, origins, headers, the audit log: through the API."""

import json
import sqlite3

import jwt
import pytest
from api_client import running
from callers import BOOTSTRAP, guarded
from cryptography.hazmat.primitives.asymmetric import ec
from jwt.algorithms import ECAlgorithm

from service.access.principal import Role
from service.api.guard import page_policy
from service.errors import ConfigError

pytestmark = pytest.mark.anyio


async def test_first_key_comes_from_the_bootstrap_key(make_app, tmp_path):
    async with guarded(make_app, tmp_path) as callers:
        root = await callers.with_token(BOOTSTRAP)
        assert (await root.http.get("/v1/me")).json() == {"tenant": "default", "role": "admin", "key_id": "bootstrap"}
        made = (await root.http.post("/v1/keys", json={"role": "operate", "name": "dome", "days": 1})).json()
        assert made["key"].startswith(f"skypose_{made['id']}_")
        dome = await callers.with_token(made["key"])
        assert (await dome.http.get("/v1/me")).json() == {"tenant": "default", "role": "operate", "key_id": made["id"]}
        listed = await root.http.get("/v1/keys")
        assert [key["id"] for key in listed.json()["keys"]] == [made["id"]]
        assert made["key"] not in listed.text
        assert "sha256" not in listed.text


async def test_revoked_key_stops_at_once(make_app, tmp_path):
    async with guarded(make_app, tmp_path) as callers:
        root, dome = await callers.with_token(BOOTSTRAP), await callers.client("default", "read")
        key_id = (await dome.http.get("/v1/me")).json()["key_id"]
        assert (await root.http.delete(f"/v1/keys/{key_id}")).status_code == 204
        assert (await dome.http.get("/v1/me")).status_code == 401
        assert (await root.http.get("/v1/keys")).json()["keys"][0]["revoked_at"]


@pytest.mark.parametrize("token", ["", "x", "skypose_", "skypose_00000000_short", "a.b.c", "é", "skypose_ " + "A" * 60])
async def test_what_is_no_key_is_refused(make_app, tmp_path, token):
    async with guarded(make_app, tmp_path) as callers:
        api = await callers.with_token(None)
        for scheme in ("Bearer", "Basic"):
            headers = {"Authorization": f"{scheme} {token}".encode()}
            assert (await api.http.get("/v1/me", headers=headers)).status_code == 401


async def test_wrong_secret_of_a_known_id(make_app, tmp_path):
    async with guarded(make_app, tmp_path) as callers:
        key = await callers.key("acme")
        wrong = await callers.with_token(key[:-1] + ("A" if key[-1] != "A" else "B"))
        unknown = await callers.with_token("skypose_00000000_" + "A" * 43)
        answers = [await api.http.get("/v1/me") for api in (wrong, unknown)]
        assert [answer.status_code for answer in answers] == [401, 401]
        assert answers[0].content == answers[1].content


@pytest.mark.usefixtures("one_process")
async def test_a_key_that_was_changed_in_the_database_is_taken_no_more(make_app, tmp_path):
    """As any other that is no key, and told to who may read the list."""
    async with guarded(make_app, tmp_path) as callers:
        root, key = await callers.with_token(BOOTSTRAP), await callers.key("default", "read")
        key_id = key.split("_")[1]
        with sqlite3.connect(tmp_path / "data" / "skypose.sqlite3") as database:
            database.execute("UPDATE api_keys SET role = 'admin' WHERE id = ?", [key_id])
        database.close()
        answer = await (await callers.with_token(key)).http.get("/v1/me")
        assert answer.status_code == 401
        listed = (await root.http.get("/v1/keys")).json()
        assert listed["damaged"] == [key_id] and key_id not in [one["id"] for one in listed["keys"]]
        assert (await root.http.delete(f"/v1/keys/{key_id}")).status_code == 204


@pytest.mark.usefixtures("one_process")
async def test_use_is_noted_and_the_secret_is_not_stored(make_app, tmp_path):
    async with guarded(make_app, tmp_path) as callers:
        key = await callers.key("acme")
        api = await callers.with_token(key)
        await api.http.get("/v1/me")
        await callers.app.state.services.keys.note_use()
        assert (await api.http.get("/v1/keys")).json()["keys"][0]["last_used_at"]
        folder = tmp_path / "data"
        secret = key.split("_", 2)[2].encode()
        assert not [file for file in folder.iterdir() if secret in file.read_bytes()]


async def test_key_past_its_end_and_keys_past_the_quota(make_app, tmp_path):
    async with guarded(make_app, tmp_path, quota_keys=2) as callers:
        keys = callers.app.state.services.keys
        _, ended = await keys.create("acme", Role.ADMIN, "test", 1e-9)
        assert (await (await callers.with_token(ended)).http.get("/v1/me")).status_code == 401
        acme = await callers.client("acme")
        answer = await acme.http.post("/v1/keys", json={"role": "read", "name": "one more"})
        assert (answer.status_code, answer.json()["setting"]) == (429, "SKYPOSE_QUOTA_KEYS")
        await callers.client("other")


async def test_objects_past_the_quota(make_app, tmp_path):
    async with guarded(make_app, tmp_path, quota_objects=1) as callers:
        acme, other = await callers.client("acme"), await callers.client("other")
        made = await acme.http.post("/v1/objects", json={"name": "one"})
        answer = await acme.http.post("/v1/objects", json={"name": "one more"})
        assert (answer.status_code, answer.json()["setting"]) == (429, "SKYPOSE_QUOTA_OBJECTS")
        assert (await other.http.post("/v1/objects", json={"name": "another"})).status_code == 201
        await acme.http.delete(f"/v1/objects/{made.json()['object_id']}")
        assert (await acme.http.post("/v1/objects", json={"name": "one more"})).status_code == 201


async def test_token_of_an_identity_provider_is_a_tenant(make_app, tmp_path):
    key = ec.generate_private_key(ec.SECP256R1())
    jwks = tmp_path / "jwks.json"
    jwks.write_text(json.dumps({"keys": [ECAlgorithm.to_jwk(key.public_key(), as_dict=True)]}))
    provider = {"oidc_issuer": "https://id.example", "oidc_audience": "skypose", "oidc_jwks": str(jwks)}
    claims = {
        "iss": "https://id.example",
        "aud": "skypose",
        "sub": "me",
        "exp": 2**33,
        "tenant": "acme",
        "role": "operate",
    }
    async with guarded(make_app, tmp_path, **provider) as callers:
        person = await callers.with_token(jwt.encode(claims, key, "ES256"))
        assert (await person.http.get("/v1/me")).json() == {"tenant": "acme", "role": "operate", "key_id": "oidc:me"}
        session_id = await person.session()
        assert (await (await callers.client("acme")).http.get(f"/v1/sessions/{session_id}")).status_code == 200
        stranger = await callers.with_token(jwt.encode({**claims, "role": "cook"}, key, "ES256"))
        answer = await stranger.http.get("/v1/sessions")
        assert (answer.status_code, answer.json()["claim"]) == (403, "role")


async def test_nobody_starts_where_nobody_could_get_in(make_app):
    for settings in ({"auth": "required"}, {"host": "0.0.0.0"}, {"host": "example.org"}):
        with pytest.raises(ConfigError, match="keys create"):
            async with running(make_app(**settings)):
                pass
    for settings in ({"auth": "off", "host": "0.0.0.0"}, {"host": "::1"}, {"host": "localhost"}):
        async with running(make_app(**settings)) as api:
            assert (await api.http.get("/v1/me")).json()["key_id"] == "local"


async def test_a_key_is_honoured_where_none_is_needed(make_app):
    async with running(make_app()) as api:
        _, key = await api.app.state.services.keys.create("acme", Role.READ, "test", None)
        for token, status in ((key, 200), (key[:-2] + "zz", 401)):
            answer = await api.http.get("/v1/me", headers={"Authorization": f"Bearer {token}"})
            assert answer.status_code == status
            assert status == 401 or answer.json()["tenant"] == "acme"


async def test_off_looks_at_no_credential(make_app):
    async with running(make_app(auth="off", host="0.0.0.0")) as api:
        for value in ("Basic eDp5", "Bearer of-the-proxy"):
            answer = await api.http.get("/v1/me", headers={"Authorization": value})
            assert answer.json() == {"tenant": "default", "role": "admin", "key_id": "local"}


async def test_what_counts_over_all_tenants_is_the_operators(make_app, tmp_path):
    async with guarded(make_app, tmp_path) as callers:
        prometheus, acme = await callers.client("default", "read"), await callers.client("acme")
        await acme.http.put("/v1/sessions/x/frames/0")
        assert "skypose_request_seconds" in (await prometheus.http.get("/metrics")).text
        assert (await acme.http.get("/metrics")).status_code == 403
        mine, all_of_it = [(await api.http.get("/v1/system")).json() for api in (acme, prometheus)]
        assert (mine["settings"], mine["workers"]) == ({}, [])
        assert all_of_it["settings"]["auth"] == "required"
        assert str(tmp_path) not in json.dumps(all_of_it)


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 200),
        ({"Host": "localhost:8000"}, 200),
        ({"Host": "[::1]:8000"}, 200),
        ({"Host": "attacker.example"}, 403),  # a name that was made to lead here
        ({"Host": "127.0.0.1.attacker.example"}, 403),
        ({"Host": "dome.example"}, 200),
        ({"Host": "127.0.0.1:8000", "Origin": "http://127.0.0.1:8000"}, 200),
        ({"Origin": "http://127.0.0.1:9000"}, 403),
        ({"Origin": "https://attacker.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Origin": "https://page.example"}, 200),
        ({"Origin": "http://["}, 403),
    ],
)
async def test_pages_of_other_sites_get_nothing(make_app, headers, status):
    app = make_app(allowed_hosts="dome.example", allowed_origins="https://page.example")
    async with running(app) as api:
        for method, path in (("GET", "/v1/sessions"), ("POST", "/v1/tickets"), ("GET", "/metrics")):
            answer = await api.http.request(method, path, headers=headers)
            assert answer.status_code in (status, status + 1), (path, answer.text)
            if status == 403:
                assert answer.json()["type"] == "urn:skypose:problem:foreign-origin"
                assert answer.json()["setting"].startswith("SKYPOSE_ALLOWED_")
            allowed = answer.headers.get("access-control-allow-origin")
            assert allowed == ("https://page.example" if headers.get("Origin") == "https://page.example" else None)


async def test_every_answer_has_security_headers(api):
    for path in ("/", "/docs", "/static/favicon.svg", "/v1/sessions", "/v1/sessions/x", "/nothing", "/healthz"):
        headers = (await api.http.get(path)).headers
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "frame-ancestors 'none'" in policy
        assert "http" not in policy
    assert "authorization" in (await api.http.get("/v1/sessions")).headers["vary"].lower()


def test_page_policy_knows_the_inline_scripts():
    policy = page_policy('<script src="/a.js"></script><script type="importmap">{}</script><script>1</script>')
    scripts = next(part for part in policy.split("; ") if part.startswith("script-src"))
    assert scripts.count("'sha256-") == 2
    assert "unsafe" not in policy


async def test_audit_log_tells_who_did_what(make_app, tmp_path):
    async with guarded(make_app, tmp_path) as callers:
        acme, reader = await callers.client("acme"), await callers.client("acme", "read")
        session_id = await acme.ready_session()
        await acme.post(session_id, 1)
        await reader.http.delete(f"/v1/sessions/{session_id}")
        await acme.http.get(f"/v1/sessions/{session_id}/checkpoint")
        await acme.http.delete(f"/v1/sessions/{session_id}")
        nobody = await callers.with_token(None)
        for _ in range(3):
            await nobody.http.get(f"/v1/sessions/{session_id}?ticket=hush", headers={"Authorization": "Bearer hush"})
        await callers.app.state.services.audit.store(final=True)
        entries = (await acme.http.get("/v1/audit")).json()["entries"]
        me = (await acme.http.get("/v1/me")).json()["key_id"]
        assert [(entry["action"], entry["outcome"]) for entry in entries if entry["actor"] == me] == [
            ("POST /v1/models", 201),
            ("POST /v1/sessions", 201),
            ("GET /v1/sessions/{session_id}/checkpoint", 200),
            ("DELETE /v1/sessions/{session_id}", 204),
        ]
        refused = [entry for entry in entries if entry["actor"] != me]
        assert [(entry["outcome"], entry["target"]) for entry in refused] == [(403, session_id)]
        root = await callers.with_token(BOOTSTRAP)
        text = (await root.http.get("/v1/audit")).text
        unknown = json.loads(text)["entries"]
        assert [(entry["outcome"], entry["count"], entry["actor"]) for entry in unknown] == [(401, 3, "-")]
        assert "hush" not in text
