"""Sessions: the effective configuration is shown, what does not fit is refused by name."""

import pytest
from fake_worker import CUBE

from service.api.schemas import Session
from service.inference.params import preset_defaults

pytestmark = pytest.mark.anyio
JOINTS = CUBE + b"joint"


async def create(api, data=CUBE, **body):
    model_id = (await api.model(data)).json()["model_id"]
    return await api.http.post("/v1/sessions", json={"model_id": model_id, **body})


async def test_answer_holds_the_whole_configuration(api):
    answer = await create(api, filter={"particles": 77, "seed": 5}, name="one")
    body = answer.json()
    Session.model_validate(body)
    assert (body["name"], body["state"], body["frames"], body["status"]) == (
        "one",
        "waiting_for_background",
        0,
        None,
    )
    assert (body["filter"]["particles"], body["filter"]["seed"]) == (77, 5)
    assert body["filter"]["preset"] == "balanced"
    assert body["motion"]["frame_interval_s"] > 0
    assert (await api.http.get(answer.headers["location"])).json() == body


async def test_preset_lies_under_what_is_sent(api):
    paper = preset_defaults("paper")
    body = (await create(api, filter={"preset": "paper"})).json()
    assert body["filter"]["particles"] == paper["filter"]["particles"]
    body = (await create(api, filter={"preset": "paper", "particles": 9})).json()
    assert (body["filter"]["particles"], body["filter"]["resampler"]) == (9, "multinomial")


@pytest.mark.parametrize(
    ("body", "field"),
    [
        ({"colour": "red"}, "colour"),
        ({"filter": {"colour": "red"}}, "filter.colour"),
        ({"filter": {"particles": 0}}, "filter"),
        ({"filter": {"particles": "many"}}, "filter.particles"),
        ({"filter": {"preset": "best"}}, "filter.preset"),
        ({"filter": 3}, "filter"),
        ({"motion": {"rotation_deg": -1}}, "motion"),
        ({"joints": {"free": ["wing"]}}, "joints"),
        ({"joints": {"fixed": {"panel": 100}}}, "joints.fixed.panel"),
        ({"joints": {"free": ["panel"], "fixed": {"panel": 1}}}, "joints.fixed.panel"),
        ({"name": "x" * 201}, "name"),
    ],
)
async def test_bad_configuration_names_the_field(api, body, field):
    answer = await create(api, JOINTS, **body)
    assert answer.status_code == 422, answer.text
    assert answer.json()["field"] == field
    assert (await api.http.get("/v1/sessions")).json()["sessions"] == []


@pytest.mark.parametrize("text", ["{", "[]", '{"model_id": NaN}', "", '{"model_id": 3}'])
async def test_bad_json_is_refused(api, text):
    answer = await api.http.post("/v1/sessions", content=text, headers={"Content-Type": "application/json"})
    assert answer.status_code == 422, answer.text


async def test_large_json_and_wrong_type(api):
    answer = await api.http.post("/v1/sessions", content=b" " * (257 << 10))
    assert (answer.status_code, answer.json()["setting"]) == (413, "SKYPOSE_MAX_JSON_KB")
    answer = await api.http.post("/v1/sessions", content=b"{}", headers={"Content-Type": "text/plain"})
    assert answer.status_code == 415


async def test_unknown_model_and_session(api):
    assert (await api.http.post("/v1/sessions", json={"model_id": "x"})).status_code == 404
    for call in ("", "/estimates", "/estimates/latest", "/estimates/0", "/particles", "/events", "/export"):
        answer = await api.http.get(f"/v1/sessions/x{call}")
        assert answer.status_code == 404, call
        assert answer.headers["content-type"] == "application/problem+json"
    assert (await api.http.delete("/v1/sessions/x")).status_code == 404


async def test_joints_not_estimated_are_named(api):
    assert "panel" in (await create(api, JOINTS)).json()["warnings"][0]
    assert (await create(api, JOINTS, joints={"free": "all"})).json()["warnings"] == []
    fixed = (await create(api, JOINTS, joints={"fixed": {"panel": 30}})).json()
    assert (fixed["warnings"], fixed["joints"]["fixed"]) == ([], {"panel": 30.0})


async def test_fixed_joint_is_in_the_pose_and_not_in_the_spread(api):
    session_id = await api.ready_session(JOINTS, joints={"fixed": {"panel": 30}})
    body = (await api.post(session_id, 1)).json()
    assert body["best"]["joints"] == {"panel": 30.0}
    assert body["spread"]["joints"] == {}
    assert len(body["spread"]["covariance"]) == len(body["spread"]["covariance_order"]) == 6


async def test_deleted_session_is_gone(api):
    session_id = await api.ready_session()
    await api.post(session_id, 1)
    await api.http.delete(f"/v1/sessions/{session_id}")
    assert (await api.post(session_id, 2)).status_code == 404
    assert (await api.http.get("/v1/sessions")).json()["sessions"] == []
