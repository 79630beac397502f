"""Sessions to which nobody posts an empty frame: `background: auto`."""

import pytest
from api_client import PNG, image

pytestmark = pytest.mark.anyio


async def read(api, session_id: str) -> dict:
    return (await api.http.get(f"/v1/sessions/{session_id}")).json()


async def test_frames_are_taken_at_once_and_the_sky_is_learned_from_some_of_the_first(api):
    session_id = await api.session(background="auto", camera={"headers": "ignore"})
    session = await read(api, session_id)
    assert (session["state"], session["background"]) == ("ready", None)
    assert session["camera"]["background"] == "auto" and session["camera"]["headers"] == "ignore"
    learned = []
    for n in range(10):
        answer = await api.post(session_id, n)
        assert answer.status_code == 200 and answer.json()["assumed"] == ["background", "time"]
        learned.append((await read(api, session_id))["background_frames"])
    assert learned == [1, 2, 3, 3, 4, 4, 4, 4, 5, 5]
    assert (await read(api, session_id))["background"]["source"] == "auto"
    again = await api.put(session_id, 3, 3)
    assert again.json()["duplicate"] is True and (await read(api, session_id))["background_frames"] == 5


async def test_what_is_posted_goes_before_what_would_be_learned(api):
    session_id = await api.session(background="auto")
    await api.http.post(f"/v1/sessions/{session_id}/background", content=image(9), headers=PNG)
    for n in range(3):
        assert (await api.post(session_id, n)).json()["assumed"] == ["time"]
    assert (await read(api, session_id))["background_frames"] == 1


async def test_a_frame_that_is_refused_leaves_no_order_behind(api):
    session_id = await api.session(background="auto")
    assert (await api.post(session_id, 1, time="yesterday")).status_code == 422
    assert (await api.post(session_id, 1, time="2026-11-20T03:00:00Z")).json()["assumed"] == ["background"]
    assert (await read(api, session_id))["background_frames"] == 1


async def test_other_words_are_refused(api):
    model = (await api.model()).json()
    answer = await api.http.post("/v1/sessions", json={"model_id": model["model_id"], "background": "none"})
    assert (answer.status_code, answer.json()["field"]) == (422, "background")
