"""What was tracked, read back."""

import csv
import io

import cv2
import numpy as np
import pytest
from api_client import running
from fake_worker import CUBE

pytestmark = pytest.mark.anyio


async def tracked(api, n_frames: int, **body) -> str:
    session_id = await api.ready_session(CUBE + b"joint", joints={"free": "all"}, **body)
    for n in range(n_frames):
        assert (await api.post(session_id, n)).status_code == 200
    return session_id


async def test_pages_hold_every_estimate_once(api):
    session_id = await tracked(api, 7)
    here = f"/v1/sessions/{session_id}/estimates"
    seen, url = [], f"{here}?limit=3"
    while url:
        page = (await api.http.get(url)).json()
        seen += [estimate["index"] for estimate in page["estimates"]]
        url = page["next"]
    assert seen == list(range(7))
    assert [e["index"] for e in (await api.http.get(f"{here}?after=4")).json()["estimates"]] == [5, 6]
    assert (await api.http.get(f"{here}/latest")).json() == (await api.http.get(f"{here}/6")).json()
    assert (await api.http.get(f"{here}/7")).status_code == 404
    assert (await api.http.get(f"{here}/seven")).status_code == 422


async def test_overlay_is_the_frame_with_blue(api):
    session_id = await tracked(api, 1)
    answer = await api.http.get(f"/v1/sessions/{session_id}/estimates/0/overlay.png")
    assert answer.headers["content-type"] == "image/png"
    picture = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (16, 16, 3)


async def test_particles_as_json_and_npz(api):
    session_id = await tracked(api, 2)
    url = f"/v1/sessions/{session_id}/particles"
    data = (await api.http.get(url)).json()
    assert (data["index"], data["joint_names"]) == (1, ["panel"])
    assert abs(sum(data["weights"]) - 1) < 1e-9
    packed = await api.http.get(url, headers={"Accept": "application/x-npz"})
    arrays = np.load(io.BytesIO(packed.content))
    for name in ("orientation", "position_px", "scale_px", "joints", "weights"):
        np.testing.assert_array_equal(arrays[name], np.array(data[name]))
        assert arrays[name].dtype == np.float64 and arrays[name].flags.c_contiguous
    assert (arrays["orientation"].shape[1], arrays["joints"].shape[1], arrays["index"].dtype) == (4, 1, np.int64)
    assert (await api.http.get(f"{url}?index=0")).json()["index"] == 0
    assert (await api.http.get(f"{url}?index=2")).status_code == 404


async def test_retention_keeps_estimates_and_forgets_the_rest(make_app):
    app = make_app(keep_frame_bodies=2, keep_particle_sets=2, keep_particle_every=3)
    async with running(app) as api:
        session_id = await tracked(api, 8)
        here = f"/v1/sessions/{session_id}"
        overlays = [(await api.http.get(f"{here}/estimates/{n}/overlay.png")).status_code for n in range(8)]
        assert overlays == [410] * 6 + [200] * 2
        sets = [(await api.http.get(f"{here}/particles?index={n}")).status_code for n in range(8)]
        assert sets == [200, 410, 410, 200, 410, 410, 200, 200]
        assert len((await api.http.get(f"{here}/estimates")).json()["estimates"]) == 8


async def test_csv_export(api):
    session_id = await tracked(api, 3)
    answer = await api.http.get(f"/v1/sessions/{session_id}/export?format=csv")
    rows = list(csv.DictReader(io.StringIO(answer.text)))
    latest = (await api.http.get(f"/v1/sessions/{session_id}/estimates/latest")).json()
    assert float(rows[2]["qw"]) == latest["best"]["orientation"]["w"]
    assert float(rows[2]["joint:panel_deg"]) == latest["best"]["joints"]["panel"]
    refused = await api.http.get(f"/v1/sessions/{session_id}/export?format=xls")
    assert (refused.status_code, refused.json()["field"]) == (422, "query:format")
    needs_attitude = await api.http.get(f"/v1/sessions/{session_id}/export?format=stk")
    assert (needs_attitude.status_code, needs_attitude.json()["field"]) == (409, "query:format")
