"""Two applications on one PostgreSQL: whichever is asked, the session's owner answers."""

import asyncio
import socket
from contextlib import AsyncExitStack

import httpx
import orjson
import pytest
from api_client import PNG, Api, image, served
from callers import BOOTSTRAP
from fake_worker import FakeWorker
from starlette.requests import Request

from service.access.principal import LOCAL
from service.api.digest import sha256
from service.api.forwarding import Call
from service.main import create_app
from service.settings import Settings
from service.store import instances, sessions
from service.workers.inline import InlineTransport

pytestmark = pytest.mark.anyio


class Slow(FakeWorker):
    delay_s = 0.02


@pytest.fixture
async def pair(postgres, tmp_path, anyio_backend):
    """Starts two applications on one database, each on a real port."""
    url = postgres.database()
    async with AsyncExitStack() as stack:

        async def start(headers: dict[str, str] | None = None, **settings) -> tuple[Api, Api]:
            found = []
            for name in ("a", "b"):
                with socket.socket() as probe:
                    probe.bind(("127.0.0.1", 0))
                    port = probe.getsockname()[1]
                given = {"data_dir": tmp_path / name, "database_url": url, "port": port, **settings}
                app = create_app(Settings(**given), InlineTransport(Slow))
                await stack.enter_async_context(served(app, port))
                client = httpx.AsyncClient(base_url=f"http://127.0.0.1:{port}", timeout=60, headers=headers)
                found.append(Api(await stack.enter_async_context(client), app))
            return tuple(found)

        yield start


def resident(api: Api) -> set[str]:
    return set(api.app.state.services.registry.resident)


async def watch(api: Api, session_id: str, heard: asyncio.Queue) -> None:
    async with api.http.stream("GET", f"/v1/sessions/{session_id}/events?after=0") as answer:
        async for line in answer.aiter_lines():
            if line.startswith("data: "):
                heard.put_nowait(orjson.loads(line[6:]))


async def test_either_process_answers_for_the_one_owner(pair):
    one, two = await pair()
    session_id = await one.ready_session()
    heard: asyncio.Queue = asyncio.Queue()
    watching = asyncio.create_task(watch(two, session_id, heard))
    answers = [await api.put(session_id, n, n) for n, api in enumerate((two, one, two))]
    assert [answer.json()["index"] for answer in answers] == [0, 1, 2]
    assert [(await heard.get())["seq"] for _ in range(3)] == [1, 2, 3]
    assert (resident(one), resident(two)) == ({session_id}, set())
    # Repeats, refusals, keys and headers are those of the owner.
    assert (await two.put(session_id, 1, 1)).json() == {**answers[1].json(), "duplicate": True}
    refused = await two.put(session_id, 7, 7)
    assert (refused.status_code, refused.json()["expected"]) == (409, 3)
    posted = await two.post(session_id, 3, headers={"Idempotency-Key": "k", "Prefer": "respond-async"})
    assert (posted.status_code, posted.headers["preference-applied"]) == (202, "respond-async")
    while (found := await two.http.get(posted.headers["location"])).status_code == 202:
        pass
    assert found.json()["index"] == 3
    # It is deleted at the other process: its watchers and its owner hear of it.
    assert (await one.http.get(f"/v1/sessions/{session_id}")).json()["frames"] == 4
    assert (await two.http.delete(f"/v1/sessions/{session_id}")).status_code == 204
    while (last := await heard.get())["type"] != "end":
        pass
    await watching
    assert last["reason"] == "deleted"
    assert (await one.put(session_id, 4, 4)).status_code == 404


async def test_a_watcher_elsewhere_hears_of_frames_whose_process_died_before_it_told(pair, monkeypatch):
    one, two = await pair()
    session_id = await one.ready_session()
    heard: asyncio.Queue = asyncio.Queue()
    watching = asyncio.create_task(watch(two, session_id, heard))
    await one.put(session_id, 0, 0)
    assert (await heard.get())["seq"] == 1
    monkeypatch.setattr(one.app.state.services.archive.database, "tell", lambda signal: None)
    await one.put(session_id, 1, 1)
    assert (await heard.get())["seq"] == 2  # the log is looked at, not only when somebody says so
    watching.cancel()


async def test_a_session_moves_while_it_is_in_use(pair):
    one, two = await pair()
    session_id = await one.ready_session()
    others = two.app.state.services.forwarding.cluster.me.id
    posts = [asyncio.create_task(one.post(session_id, n)) for n in range(8)]
    await asyncio.sleep(0)
    moved = await two.http.post(f"/v1/sessions/{session_id}/move")
    assert moved.json() == {"session_id": session_id, "process": others}
    more = [asyncio.create_task(api.post(session_id, 8 + n)) for n, api in enumerate((one, two, one))]
    answers = [(await post).json() for post in [*posts, *more]]
    assert sorted(answer["index"] for answer in answers) == list(range(11))
    assert not any(answer["duplicate"] for answer in answers)
    assert (resident(one), resident(two)) == (set(), {session_id})
    missing = await one.http.post(f"/v1/sessions/{session_id}/move", params={"to": "nobody"})
    assert missing.status_code == 404
    assert (await one.http.post(f"/v1/sessions/{session_id}/move", params={"to": others})).json() == moved.json()


async def test_an_owner_that_was_overtaken_hands_the_frame_on(pair):
    one, two = await pair()
    session_id = await one.ready_session()
    assert (await one.post(session_id, 0)).json()["index"] == 0
    database = two.app.state.services.archive.database
    mine = one.app.state.services.forwarding.cluster.me
    await database.write(instances.beat, mine, -1.0)  # as if it had been stopped: its lease is over
    assert (await two.post(session_id, 1)).json()["index"] == 1
    # It does not know yet: nothing of its frame is written, and the other answers for it.
    await database.write(instances.beat, mine, 60.0)
    assert (await one.post(session_id, 2)).json()["index"] == 2
    assert resident(two) == {session_id}


async def test_an_idle_session_is_given_up(pair):
    one, two = await pair(session_idle_s=1e-6)
    session_id = await one.ready_session()
    await one.post(session_id, 0)
    database = one.app.state.services.archive.database
    while await database.read(instances.owner, session_id) is not None:
        await asyncio.sleep(0)  # until housekeeping has let it go
    assert (await two.post(session_id, 1)).json()["index"] == 1


async def test_nobody_listens_where_the_owner_was(pair):
    one, two = await pair()
    session_id = await one.ready_session()
    database = two.app.state.services.archive.database
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        dead = instances.Instance("dead", f"http://127.0.0.1:{probe.getsockname()[1]}")
    await database.write(instances.register, dead, 60.0)
    epoch = (await database.read(sessions.get, session_id)).epoch
    mine = one.app.state.services.forwarding.cluster.me.id
    await database.write(instances.release, session_id, epoch, mine, "dead")
    assert (await two.post(session_id, 0)).json()["index"] == 0
    assert (await one.put(session_id, 0, 0)).json()["duplicate"]


async def test_access_is_decided_where_the_call_comes_in(pair, tmp_path):
    file = tmp_path / "bootstrap"
    file.write_text(BOOTSTRAP)
    one, two = await pair({"Authorization": f"Bearer {BOOTSTRAP}"}, auth="required", bootstrap_key_file=file)
    session_id = await one.ready_session()
    assert (await two.put(session_id, 0, 0)).status_code == 200
    # A ticket of one is good at the other, once.
    ticket = (await one.http.post("/v1/tickets")).json()["ticket"]
    anybody = httpx.AsyncClient(base_url=two.http.base_url)
    async with anybody:
        place = f"/v1/sessions/{session_id}/events?after=0&ticket={ticket}"
        async with anybody.stream("GET", place) as stream:
            assert stream.status_code == 200
        assert (await anybody.get(place)).status_code == 401
        # A key that was ended at one is soon no longer taken at the other.
        key = (await one.http.post("/v1/keys", json={"role": "operate", "name": "n"})).json()
        shown = {"Authorization": f"Bearer {key['key']}"}
        assert (await anybody.get("/v1/me", headers=shown)).status_code == 200
        await one.http.delete(f"/v1/keys/{key['id']}")
        while (await anybody.get("/v1/me", headers=shown)).status_code == 200:
            await asyncio.sleep(0)
        # Only peers may say who calls, each for the call and the process it signed.
        path = f"/v1/sessions/{session_id}/frames/1"
        peers = one.app.state.services.forwarding.peers
        to = two.app.state.services.forwarding.cluster.me.id
        body = await sha256(image(1))
        good = peers.sign(LOCAL, to, "PUT", path, body)
        for token, status in (
            ("x.y.z", 401),
            (peers.sign(LOCAL, to, "DELETE", path, body), 401),
            (peers.sign(LOCAL, to, "PUT", path, await sha256(image(2))), 401),
            (peers.sign(LOCAL, "another", "PUT", path, body), 503),
            (good, 503),  # but not the owner's: it is not handed on again
            (good, 401),  # once
        ):
            answer = await anybody.put(path, content=image(1), headers={**PNG, "X-Skypose-Peer": token})
            assert (answer.status_code, status) == (status, status), answer.text
    assert (await two.put(session_id, 1, 1)).json()["index"] == 1
    # A call that is handed on is one entry of the audit log.
    assert (await two.http.post(f"/v1/sessions/{session_id}/move")).status_code == 200
    for api in (one, two):
        await api.app.state.services.audit.store()
    entries = (await one.http.get("/v1/audit")).json()["entries"]
    assert [entry["action"].rpartition("/")[2] for entry in entries].count("move") == 1


async def test_a_signature_that_the_owner_does_not_take_is_no_answer_to_the_client(pair, monkeypatch):
    one, two = await pair()
    session_id = await one.ready_session()
    peers = one.app.state.services.forwarding.peers
    verify, refused = peers.verify, []

    def verify_once_more(token, method, target):
        if not refused:
            refused.append(token)
            verify(token, method, target)  # as if a copy of the call had come first
        return verify(token, method, target)

    monkeypatch.setattr(peers, "verify", verify_once_more)
    answer = await two.put(session_id, 0, 0)
    assert (answer.status_code, answer.json()["index"], len(refused)) == (200, 0, 1)


def test_the_target_is_the_path_as_it_came():
    scope = {"type": "http", "method": "PUT", "path": "/v1/a/b", "raw_path": b"/v1/a%2Fb", "query_string": b"x=1"}
    assert Call.of(Request({**scope, "headers": []}), "s", LOCAL).target == "/v1/a%2Fb?x=1"
