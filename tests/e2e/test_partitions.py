"""What the partition loop stands on: its wires, its clocks, and that its outside judge finds what cannot have been.

The loop itself is a command (docs/cluster.md).
"""

import contextlib
import json
import socket
import subprocess
import sys
import threading
from dataclasses import asdict

import pytest
from histories import Call, MissingError, built_judge, judged
from stepped_clock import Clock, compiled
from wires import CALM, DOWN, Weather, Wires


@pytest.fixture(scope="module")
def judge(tmp_path_factory):
    try:
        return built_judge(tmp_path_factory.mktemp("judge"))
    except MissingError as error:
        pytest.skip(str(error))


def call(kind, begin, end, result, session="s", **more):
    return Call(session, 0, kind, begin, end, result, **more)


def stored(begin, end, index, *, repeats=False, **more):
    given = {"index": index, "body": f"b{index}", "at": index, "answer": f"a{index}", "repeats": repeats}
    return call("put", begin, end, "stored", **given | more)


def read(begin, end, index, answer=None):
    found = {"at": index, "answer": answer or f"a{index}"}
    return call("get", begin, end, "stored", index=index, **found)


def absent(begin, end, index):
    return call("get", begin, end, "absent", index=index)


UNKNOWN = call("put", 2, 0, "unknown", index=1, body="b1")
POSSIBLE = {
    "in turns": [
        stored(0, 1, 0),
        read(2, 3, 0),
        absent(4, 5, 1),
        stored(6, 7, 1),
        call("count", 8, 9, "counted", at=2),
    ],
    "at once": [stored(0, 9, 0), absent(1, 2, 0), read(3, 4, 0)],
    "sent again": [stored(0, 1, 0), stored(2, 3, 0, repeats=True)],
    "no answer, done late": [stored(0, 1, 0), UNKNOWN, absent(3, 4, 1), read(5, 6, 1, "x"), read(7, 8, 1, "x")],
    "no answer, never done": [stored(0, 1, 0), UNKNOWN, absent(3, 4, 1), stored(5, 6, 1, body="other")],
    "another was there": [stored(0, 1, 0), call("put", 2, 3, "conflict", index=0, body="b", answer="b0")],
    "under a key": [
        call("post", 0, 1, "stored", key="k", body="b", at=0, answer="a0"),
        call("by-key", 2, 3, "stored", key="k", at=0, answer="a0"),
        call("by-key", 4, 5, "absent", key="l"),
    ],
}
IMPOSSIBLE = {
    "lost": [stored(0, 1, 0), absent(2, 3, 0)],
    "lost, by the count": [stored(0, 1, 0), call("count", 2, 3, "counted", at=0)],
    "applied twice": [stored(0, 1, 0), stored(2, 3, 0)],
    "two at one index": [stored(0, 1, 0), stored(0, 1, 0, body="other")],
    "changed": [stored(0, 1, 0), read(2, 3, 0, "other")],
    "changed back": [stored(0, 1, 0), UNKNOWN, read(3, 4, 1, "x"), read(5, 6, 1, "y")],
    "seen, then not": [stored(0, 9, 0), read(1, 2, 0), absent(3, 4, 0)],
    "before it was asked for": [absent(0, 1, 0), read(2, 3, 0), stored(4, 5, 0)],
    "a gap": [stored(0, 1, 0), stored(2, 3, 2)],
    "one key, two frames": [
        call("post", 0, 1, "stored", key="k", body="b", at=0, answer="a0"),
        call("post", 2, 3, "stored", key="k", body="b", at=1, answer="a1"),
    ],
}


@pytest.mark.parametrize("name", [*POSSIBLE, *IMPOSSIBLE])
def test_the_judge_knows_what_can_have_been(judge, tmp_path, name):
    file = tmp_path / "history"
    calls = [*(POSSIBLE | IMPOSSIBLE)[name], stored(0, 1, 0, session="another")]
    file.write_text("".join(json.dumps(asdict(one)) + "\n" for one in calls))
    found = judged(judge, file)
    assert (found["sessions"], found["calls"], found["undecided"]) == (2, len(calls), [])
    assert found["impossible"] == (["s"] if name in IMPOSSIBLE else [])


@pytest.fixture
def echo():
    """A wire to a server that sends back what it gets and keeps what came in."""
    server = socket.create_server(("127.0.0.1", 0))
    came: list[bytes] = []

    def answer(connection):
        with connection, contextlib.suppress(ConnectionResetError):
            while piece := connection.recv(100):
                came.append(piece)
                connection.sendall(piece)

    def accept():
        while True:
            try:
                connection, _ = server.accept()
            except OSError:
                return
            threading.Thread(target=answer, args=(connection,), daemon=True).start()

    threading.Thread(target=accept, daemon=True).start()
    wires = Wires(1)
    yield wires.to(server.getsockname()[1]), came
    wires.close()
    server.shutdown(socket.SHUT_RDWR)
    server.close()


def test_wires_carry_hold_up_cut_and_double(echo):
    wire, came = echo
    with socket.create_connection(("127.0.0.1", wire.port)) as client:
        client.sendall(b"one")
        assert client.recv(100) == b"one"
        wire.set(Weather(stalled=(DOWN,)))
        client.sendall(b"two")
        while b"two" not in came:
            pass  # it arrives; its answer does not
        client.setblocking(False)
        with pytest.raises(BlockingIOError):
            client.recv(100)
        client.setblocking(True)
        wire.set(CALM)
        assert client.recv(100) == b"two"
        wire.set(Weather(cut=True))
        with pytest.raises(ConnectionResetError):
            client.recv(100)
    wire.set(Weather(doubled_s=0.01))
    with socket.create_connection(("127.0.0.1", wire.port)) as client:
        client.sendall(b"three")
        client.shutdown(socket.SHUT_WR)
        assert client.recv(100) == b"three"
        assert client.recv(100) == b""
    while came.count(b"three") < 2:
        pass


def test_a_clock_steps_while_the_process_runs(tmp_path):
    try:
        clock = Clock(tmp_path, "c", compiled(tmp_path))
    except MissingError as error:
        pytest.skip(str(error))
    code = "import sys, time; from datetime import datetime, UTC\n"
    code += "for _ in sys.stdin: print(time.time(), datetime.now(UTC).timestamp(), time.monotonic(), flush=True)"
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "env": clock.environment}
    with subprocess.Popen([sys.executable, "-c", code], **pipes) as child:

        def ask():
            child.stdin.write("\n")
            child.stdin.flush()
            return [float(word) for word in child.stdout.readline().split()]

        before = ask()
        for step in (-3600.0, 86400.0):
            clock.step(step)
            found = ask()
            passed = found[2] - before[2]
            for now, then in zip(found[:2], before[:2], strict=True):
                assert abs(now - then - passed - step) < 1.0  # the library adds whole seconds to a clock that runs on
        child.stdin.close()
