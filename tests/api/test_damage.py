"""What is damaged in the store is told as an error, never served or gone on from; the rest is as it was."""

import pytest
from api_client import running

from service.api import schemas
from service.remote.calls import page

pytestmark = pytest.mark.anyio


async def spoil(api, statement: str) -> None:
    await api.app.state.services.archive.database.write(lambda c: c.exec_driver_sql(statement) and None)


def literal(api, data: bytes) -> str:
    shared = api.app.state.services.archive.database.shared
    return f"'\\x{data.hex()}'" if shared else f"x'{data.hex()}'"


async def test_a_changed_digit_is_an_error_and_not_an_answer(make_app):
    async with running(make_app()) as api:
        session_id = await api.ready_session()
        for n in range(3):
            await api.put(session_id, n, n)
        here = f"/v1/sessions/{session_id}"
        whole = (await api.http.get(f"{here}/estimates/0")).content
        document = (await api.http.get(f"{here}/estimates/1")).content
        digit = next(k for k in range(document.index(b"scale_px"), len(document)) if document[k : k + 1].isdigit())
        changed = document[:digit] + (b"1" if document[digit : digit + 1] != b"1" else b"2") + document[digit + 1 :]
        where = f"WHERE idx = 1 AND session_id = '{session_id}'"
        await spoil(api, f"UPDATE estimates SET document = {literal(api, changed)} {where}")
        for path in ("estimates/1", "estimates", "export?format=csv", "checkpoint"):
            answer = await api.http.get(f"{here}/{path}")
            assert (answer.status_code, answer.json()["type"]) == (500, "urn:skypose:problem:damaged"), path
            assert "Retry-After" not in answer.headers
        assert "estimates" in answer.json()["detail"]
        repeated = await api.put(session_id, 1, 1)
        assert (repeated.status_code, repeated.json()["type"]) == (500, "urn:skypose:problem:damaged")
        assert (await api.http.get(f"{here}/estimates/0")).content == whole
        assert (await api.put(session_id, 3, 3)).status_code == 200


async def test_a_list_leaves_out_what_is_damaged_and_names_it(make_app):
    async with running(make_app()) as api:
        damaged, whole = await api.ready_session(), await api.ready_session()
        await spoil(api, f"UPDATE sessions SET name = 'other' WHERE id = '{damaged}'")
        found = (await api.http.get("/v1/sessions")).json()
        assert ([one["session_id"] for one in found["sessions"]], found["damaged"]) == ([whole], [damaged])
        assert (await api.http.get(f"/v1/sessions/{damaged}")).status_code == 500
        with pytest.warns(UserWarning, match=damaged):
            page(schemas.SessionList, "/v1/sessions", {}).read(await api.http.get("/v1/sessions"))
        await spoil(api, "UPDATE models SET name = 'other'")
        found = (await api.http.get("/v1/models")).json()
        assert (found["models"], len(found["damaged"])) == ([], 1)


async def test_nothing_goes_on_from_a_damaged_state_and_it_can_be_deleted(make_app):
    async with running(make_app()) as api:
        session_id = await api.ready_session()
        await api.put(session_id, 0, 0)
    async with running(make_app()) as api:
        await spoil(api, f"UPDATE particles SET state = {literal(api, b'0')}")
        answer = await api.put(session_id, 1, 1)
        assert (answer.status_code, answer.json()["type"]) == (500, "urn:skypose:problem:damaged")
        assert (await api.http.delete(f"/v1/sessions/{session_id}")).status_code == 204
