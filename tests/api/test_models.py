"""Models: known by content, refused with a reason, kept while in use."""

import json

import pytest
from fake_worker import CUBE

from service.api.schemas import Model

pytestmark = pytest.mark.anyio
JOINTS = CUBE + b"joint"


async def test_upload_describes_the_model(api):
    answer = await api.model(JOINTS, name="sat.glb")
    assert answer.status_code == 201
    body = answer.json()
    Model.model_validate(body)
    assert (body["name"], body["parts"], body["warnings"]) == ("sat", ["body", "wing"], ["a cube"])
    joint = body["joints"][0]
    assert (joint["name"], joint["min"], joint["max"], joint["parts"]) == ("panel", -90, 90, ["wing"])
    assert joint["origin"] == [1.5, 2.0, 3.0]  # file coordinates: the fake's centre is (1, 2, 3)
    assert (await api.http.get(answer.headers["location"])).json() == body


async def test_same_content_is_one_model(api):
    first, again = await api.model(), await api.model(name="other.glb")
    assert (first.status_code, again.status_code) == (201, 200)
    assert first.json() == again.json()
    with_joints = await api.model(joints="[]")
    assert with_joints.status_code == 201
    assert with_joints.json()["model_id"] != first.json()["model_id"]


@pytest.mark.parametrize(
    ("files", "data", "status", "slug"),
    [
        ({"file": ("a.glb", b"junk")}, {}, 422, "broken-mesh"),
        ({"file": ("a.glb", b"")}, {}, 422, "invalid-input"),
        ({"file": ("a.exe", CUBE)}, {}, 415, "unsupported-media-type"),
        ({"file": ("a.glb", CUBE)}, {"joints": "{"}, 422, "invalid-joint"),
        ({"file": ("a.glb", CUBE)}, {"joints": '{"a": 1}'}, 422, "invalid-joint"),
        ({"file": ("a.glb", CUBE)}, {"joints": "[NaN]"}, 422, "invalid-joint"),
        ({"file": ("a.glb", CUBE)}, {"colour": "red"}, 422, "invalid-input"),
        ({"other": ("a.glb", CUBE)}, {}, 422, "invalid-input"),
    ],
)
async def test_bad_upload_is_refused(api, files, data, status, slug):
    answer = await api.http.post("/v1/models", files=files, data=data)
    assert (answer.status_code, answer.json()["type"]) == (status, f"urn:skypose:problem:{slug}")
    assert (await api.http.get("/v1/models")).json() == {"models": [], "damaged": [], "next": None}


async def test_upload_must_be_a_form(api):
    answer = await api.http.post("/v1/models", content=CUBE, headers={"Content-Type": "model/gltf-binary"})
    assert answer.status_code == 415


async def test_model_in_use_stays(api):
    session_id = await api.session()
    model_id = (await api.model()).json()["model_id"]
    refused = await api.http.delete(f"/v1/models/{model_id}")
    assert (refused.status_code, refused.json()["sessions"]) == (409, [session_id])
    assert (await api.http.delete(f"/v1/sessions/{session_id}")).status_code == 204
    assert (await api.http.delete(f"/v1/models/{model_id}")).status_code == 204
    assert (await api.http.get(f"/v1/models/{model_id}")).status_code == 404


async def test_pages(api):
    for n in range(5):
        await api.model(CUBE + bytes([n]))
    seen, url = [], "/v1/models?limit=2"
    while url:
        page = (await api.http.get(url)).json()
        seen += [model["model_id"] for model in page["models"]]
        url = page["next"]
    assert len(set(seen)) == len(seen) == 5
    assert (await api.http.get("/v1/models?limit=1001")).json()["setting"] == "SKYPOSE_MAX_PAGE"
    assert json.loads((await api.http.get("/v1/models?limit=0")).content)["status"] == 422


async def test_meshes_come_with_a_urdf_file_only(api):
    twice = [("file", ("sat.urdf", CUBE)), ("meshes", ("a/x.stl", b"1")), ("meshes", ("b/x.stl", b"2"))]
    for files in (
        twice,
        [("file", ("sat.glb", CUBE)), ("meshes", ("x.stl", b"1"))],
        [("file", ("sat.urdf", CUBE)), ("meshes", (None, b"text"))],
    ):
        answer = await api.http.post("/v1/models", files=files)
        assert (answer.status_code, answer.json()["field"]) == (422, "meshes"), answer.text
    assert (await api.http.post("/v1/models", files=twice[:1])).json()["file_type"] == "urdf"
