"""A name that there is not is answered with the one that was meant, wherever a client may have put it."""

import pytest
from api_client import image, running
from fake_worker import CUBE, FakeWorker

from service.sessions.near import did_you_mean

pytestmark = pytest.mark.anyio


@pytest.fixture
async def api(make_app, anyio_backend):
    async with running(make_app(FakeWorker)) as client:
        yield client


@pytest.mark.parametrize(
    ("body", "field", "meant"),
    [
        ({"filter": {"partices": 300}}, "filter.partices", "`particles`"),
        ({"filterx": {}}, "filterx", "`filter`"),
        ({"particles": 300}, "particles", "`filter.particles`"),
        ({"particlesx": 300}, "particlesx", "`filter.particles`"),
        ({"filter": {"orbit": "x"}}, "filter.orbit", "`prior.orbit`"),
        ({"camera": {"unit_m": 1.0}}, "camera.unit_m", "`prior.unit_m`"),
    ],
)
async def test_a_session(api, body, field, meant):
    model_id = (await api.model()).json()["model_id"]
    answer = await api.http.post("/v1/sessions", json={"model_id": model_id, **body})
    assert (answer.status_code, answer.json()["field"]) == (422, field)
    assert f"; did you mean {meant}?" in answer.json()["detail"]
    assert all("did you mean" in one["message"] for one in answer.json()["errors"])


async def test_a_key(api):
    for body, meant in (({"roles": "read"}, "`role`"), ({"calls_per_s": 1}, "`rates.calls_per_s`")):
        answer = await api.http.post("/v1/keys", json={"role": "read", "name": "x", **body})
        assert answer.status_code == 422 and f"; did you mean {meant}?" in answer.json()["detail"]


async def test_a_query(api):
    session_id = await api.ready_session()
    answer = await api.post(session_id, 0, position_angle=3)
    assert (answer.status_code, answer.json()["field"]) == (422, "query:position_angle")
    assert answer.json()["detail"].endswith("; did you mean `position_angle_deg`?")
    sky = await api.http.post(f"/v1/sessions/{session_id}/background", content=image(), params={"bordr": 3})
    assert sky.json()["detail"].endswith("; did you mean `border`?")


async def test_a_query_of_a_list(api):
    session_id = await api.ready_session()
    here = f"/v1/sessions/{session_id}"
    for path, given, meant in (
        ("/v1/sessions", "limitx", "limit"),
        ("/v1/models", "aftr", "after"),
        ("/v1/objects", "limitx", "limit"),
        ("/v1/keys", "limitx", "limit"),
        ("/v1/audit", "limitx", "limit"),
        (f"{here}/estimates", "smooth", "smoothed"),
        (f"{here}/particles", "mst", "most"),
        (f"{here}/events", "aftr", "after"),
        ("/v1/objects/any/motion", "pas", "pass"),
    ):
        answer = await api.http.get(path, params={given: 1})
        assert (answer.status_code, answer.json()["field"]) == (422, f"query:{given}"), path
        assert answer.json()["detail"].endswith(f"; did you mean `{meant}`?")


async def test_a_form(api):
    answer = await api.http.post("/v1/models", files={"file": ("cube.glb", CUBE)}, data={"joint": "[]"})
    assert (answer.status_code, answer.json()["field"]) == (422, "joint")
    assert answer.json()["detail"] == "unknown field 'joint'; did you mean `joints`?"


async def test_a_request_of_many_unknown_names_is_answered_briefly(api):
    many = {f"particle{n}": 1 for n in range(300)}
    answer = await api.http.post("/v1/sessions", json={"model_id": "x", **many})
    told = [one for one in answer.json()["errors"] if "did you mean" in one["message"]]
    assert 0 < len(told) <= 20


def test_nothing_is_made_up():
    schema = {"properties": {"file": {}, "name": {}}}
    assert did_you_mean((), "zzz", schema) == did_you_mean((), "n" * 1000, schema) == ""
    assert did_you_mean(("filter",), "name", schema) == "; did you mean `name` beside `filter`?"
