"""Health, metrics, system, documentation, the page; and what holds for every route."""

import re

import pytest
from api_client import running

from service.api import schemas
from service.api.problems import problem_type
from service.api.wire import attribute_docstrings
from service.errors import WorkerFailedError, every_error
from service.settings import Settings
from service.workers.decode_process import DecodeProcess
from service.workers.sandbox import Sandbox

pytestmark = pytest.mark.anyio


async def test_health_and_system(api):
    assert (await api.http.get("/healthz")).json()["status"] == "ok"
    ready = await api.http.get("/readyz")
    assert (ready.status_code, ready.json()["checks"]) == (200, {"worker": True, "database": True})
    system = (await api.http.get("/v1/system")).json()
    assert system["worker"] == {"scorer": "fake"}


async def test_a_sandbox_that_is_required_and_missing_refuses_the_start(make_app, monkeypatch):
    lacking = Sandbox(("seccomp",), {"Landlock": "none in this kernel"})
    monkeypatch.setattr(DecodeProcess, "sandbox", property(lambda self: self._accepted(lacking)))
    app = make_app(decode_sandbox="required")
    with pytest.raises(WorkerFailedError):
        async with running(app):
            pass
    assert app.state.refused.startswith("SKYPOSE_DECODE_SANDBOX is required")
    async with running(make_app()) as api:
        assert (await api.http.get("/readyz")).status_code == 200


async def test_metrics_count_frames_and_refusals(api):
    session_id = await api.ready_session()
    await api.post(session_id, 1)
    await api.post("nobody", 1)
    text = (await api.http.get("/metrics")).text
    assert 'skypose_frames_total{status="tracking"} 1.0' in text
    assert 'skypose_refusals_total{type="not-found"} 1.0' in text
    assert 'route="/v1/sessions/{session_id}/frames"' in text


async def test_two_applications_do_not_share_metrics(make_app, tmp_path):
    async with running(make_app()) as one:
        await one.post(await one.ready_session(), 1)
    async with running(make_app(data_dir=tmp_path / "two")) as two:
        assert 'skypose_frames_total{status="tracking"}' not in (await two.http.get("/metrics")).text


async def test_request_id_is_echoed_or_made(api):
    answer = await api.http.get("/healthz", headers={"X-Request-ID": "abc"})
    assert answer.headers["x-request-id"] == "abc"
    assert len((await api.http.get("/healthz")).headers["x-request-id"]) == 32


async def test_unknown_path_and_method_are_problems(api):
    for method, path, status in (("GET", "/nothing", 404), ("PATCH", "/v1/models", 405), ("GET", "/static/x", 404)):
        answer = await api.http.request(method, path)
        assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json")


@pytest.mark.parametrize("path", ["/", "/docs"])
async def test_pages_ask_no_other_host(api, path):
    page = (await api.http.get(path)).text
    links = re.findall(r'(?:src|href)="([^"]+)"', page)
    assert links
    for link in links:
        assert link.startswith("/"), link
        assert (await api.http.get(link)).status_code == 200, link


async def test_openapi_names_what_routes_refuse(api):
    document = (await api.http.get("/openapi.json")).json()
    post = document["paths"]["/v1/sessions/{session_id}/frames"]["post"]
    assert {"200", "202", "409", "413", "415", "422", "429"} <= set(post["responses"])
    assert "`image/png`" in post["requestBody"]["description"]
    sections = document["paths"]["/v1/sessions"]["post"]["requestBody"]["content"]["application/json"]
    assert "particles" in sections["schema"]["properties"]["filter"]["properties"]


async def test_lists_are_as_documented(api):
    session_id = await api.ready_session()
    await api.post(session_id, 1)
    for path, kind in (
        ("/v1/models", schemas.ModelList),
        ("/v1/sessions", schemas.SessionList),
        (f"/v1/sessions/{session_id}/estimates", schemas.EstimateList),
    ):
        kind.model_validate_json((await api.http.get(path)).content)


def test_every_setting_is_documented(root):
    text = (root / "docs" / "settings.md").read_text()
    for name in Settings.model_fields:
        assert f"`SKYPOSE_{name.upper()}`" in text, name
        assert attribute_docstrings(Settings)[name], name
    assert set(re.findall(r"^- `(SKYPOSE_\w+)`", text, re.M)) == {
        f"SKYPOSE_{name.upper()}" for name in Settings.model_fields
    }


def test_every_problem_is_documented(root):
    text = (root / "docs" / "errors.md").read_text()
    for kind in every_error():
        if kind.slug != "missing-blob":  # never leaves the service
            name = problem_type(kind).removeprefix("urn:skypose:problem:")
            assert f"| `{name}` | {kind.status} |" in text, kind
