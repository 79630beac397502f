"""A service that was killed, at any moment, goes on as if it had not been."""

import contextlib
import os
import random
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest
from passes import PNG, begin, box_pass, comparable, fake_pass, history
from server_process import Server

VICTIMS = ((), ("web",), ("worker",), ("worker",), ("web", "worker"))
pytestmark = pytest.mark.timeout(600)


@pytest.fixture
def server(tmp_path):
    servers = []

    def make(name: str, **settings) -> Server:
        server = Server(tmp_path / name, **settings)
        servers.append(server)
        server.start()
        return server

    yield make
    for server in servers:
        server.stop()


def put_until_answered(http: httpx.Client, session_id: str, index: int, image: bytes) -> dict:
    """A client that retries: connection errors and 503 until there is an answer."""
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline:
        try:
            answer = http.put(f"/v1/sessions/{session_id}/frames/{index}", content=image, headers=PNG)
        except httpx.TransportError:
            time.sleep(0.05)
            continue
        if answer.status_code == 200:
            return answer.json()
        assert answer.status_code in (429, 503), answer.text
    raise AssertionError("no answer")


def track(server: Server, given, **session) -> list[dict]:
    """The whole pass, undisturbed."""
    with httpx.Client(base_url=server.url, timeout=120) as http:
        session_id = begin(http, given, **session)
        for n, image in enumerate(given.frames):
            url = f"/v1/sessions/{session_id}/frames/{n}"
            http.put(url, content=image, headers=PNG).raise_for_status()
        return history(http, session_id)


def test_kills_lose_nothing_and_repeat_nothing(server):
    """The web process, the worker, or both, killed at random moments of a pass.

    The long form: SKYPOSE_TEST_KILL_FRAMES=2000 (about two kills in three frames).
    """
    given = fake_pass(int(os.environ.get("SKYPOSE_TEST_KILL_FRAMES", "5")))
    expected = track(server("calm", worker="fake_worker:FakeWorker"), given, name="body.glb")
    target = server("killed", worker="fake_worker:SlowWorker")
    dice = random.Random(1)
    acknowledged, kills = [], 0
    with httpx.Client(base_url=target.url, timeout=60) as http:
        session_id = begin(http, given, name="body.glb")
        for n, image in enumerate(given.frames):
            victims = dice.choice(VICTIMS)
            strike = threading.Thread(target=kill, args=(target, victims, dice.uniform(0, 0.08)))
            strike.start()
            acknowledged.append(comparable(put_until_answered(http, session_id, n, image)))
            strike.join()
            kills += len(victims)
        assert kills
        assert history(http, session_id) == acknowledged == expected
        session = http.get(f"/v1/sessions/{session_id}").json()
    assert (session["frames"], session["last_seq"]) == (len(given.frames), len(given.frames))


def kill(target: Server, victims: tuple[str, ...], delay_s: float) -> None:
    """SIGKILL after a random delay; the web process is started again."""
    pids = target.worker_pids() if "worker" in victims else []
    time.sleep(delay_s)
    for pid in pids:
        with contextlib.suppress(ProcessLookupError):  # it died with the web process before
            os.kill(pid, signal.SIGKILL)
    if "web" in victims:
        target.kill()
        target.start()


def test_tracker_restarted_in_the_middle_of_a_pass_gives_the_same_answers(server):
    """Restart equals no restart, bit for bit, with the real tracker."""
    given = box_pass(4)
    small = {"filter": {"particles": 200, "seed": 3}, "light": {"sun": [0.0, 0.0, -1.0]}}  # a search half as long
    target = server("real")
    expected = track(target, given, **small)
    with httpx.Client(base_url=target.url, timeout=120) as http:
        session_id = begin(http, given, **small)
        for n, image in enumerate(given.frames):
            put_until_answered(http, session_id, n, image)
            if n == 1:
                target.kill()
                target.start()
        assert history(http, session_id) == expected


def test_stop_finishes_the_frame_in_hand(server):
    """SIGTERM in the middle of a frame: its client gets the answer, and it is stored."""
    given = fake_pass(2)
    target = server("stopped", worker="fake_worker:VerySlowWorker")
    with httpx.Client(base_url=target.url, timeout=60) as http, ThreadPoolExecutor(1) as client:
        session_id = begin(http, given, name="body.glb")
        answer = client.submit(put_until_answered, http, session_id, 0, given.frames[0])
        with httpx.Client(base_url=target.url, timeout=60) as other:
            while "skypose_waiting_frames 1.0" not in other.get("/metrics").text:
                time.sleep(0.01)
        target.stop()
        assert answer.result()["index"] == 0
    target.start()
    with httpx.Client(base_url=target.url, timeout=60) as http:
        assert history(http, session_id) == [comparable(answer.result())]
