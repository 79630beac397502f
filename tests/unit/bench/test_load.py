"""The load benchmark on made-up services whose capacity is known, in virtual time; and once on a real one."""

import asyncio
import json
import os
import selectors
import sqlite3
import subprocess
import sys

import httpx
import pytest
from typer.testing import CliRunner

from service.bench.load.clients import Answer, Client, Tally, send, warm
from service.bench.load.cost import ClientMeter, SqliteCounters, Usage, cost_per_frame, cpu_s, descendants
from service.bench.load.http_target import HttpTarget
from service.bench.load.plan import Cost, LoadError, LoadPlan, LoadRow
from service.bench.load.report import capacity_table, cost_table, load_document, load_plot, row_line
from service.bench.load.scene import Scene
from service.bench.load.search import Fleet, Service, capacities, climb, measure_service
from service.cli import app

WIDE = {"COLUMNS": "200", "TERM": "dumb"}
CONTRACT = {"engine", "workers", "sessions", "particles", "frames_per_s", "p50_ms", "p99_ms"}
SCENE = Scene("a.glb", b"mesh", ("panel",), (b"sky",), (b"zero", b"one", b"two"))


class VirtualLoop(asyncio.SelectorEventLoop):
    """Nobody waits: when nothing else can run, it is at once the time of the next timer."""

    def __init__(self):
        super().__init__(selectors.SelectSelector())
        self._virtual = 0.0

    def time(self):
        return self._virtual

    def _run_once(self):
        if not self._ready and self._scheduled:
            self._virtual = max(self._virtual, self._scheduled[0]._when)
        super()._run_once()


def virtually(work):
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        return runner.run(work)


class Queue:
    """A service of so many workers that take so long for each frame, and refuse what they cannot begin at once."""

    def __init__(self, workers=1, frame_s=0.1, most_waiting=1000):
        self._places = asyncio.Semaphore(workers)
        self._frame_s, self._most_waiting = frame_s, most_waiting
        self.waiting, self.begun, self.seen = 0, 0, []

    async def begin(self, particles, seed):
        self.begun += 1
        return f"{particles}-{seed}"

    async def frame(self, session, index):
        if self.waiting >= self._most_waiting:
            return Answer(False, 10, 5)
        self.waiting += 1
        async with self._places:
            await asyncio.sleep(self._frame_s)
        self.waiting -= 1
        self.seen.append((session, index))
        return Answer(True, 100, 50)


def row(sessions, *, held, workers=1, frames_per_s=10.0, p99_ms=100.0):
    return LoadRow("process", workers, 500, 2.0, sessions, frames_per_s, 50.0, p99_ms, 0, 0, held, Cost(rows=6.0))


@pytest.mark.parametrize(("workers", "most"), [(1, 4), (2, 9)])
def test_finds_the_capacity_of_a_queue(workers, most):
    """10 frames/s per worker: 5 sessions of 2 frames/s are the limit of one, and with a bound of 3.5 frames 4 are."""

    async def work():
        service = Service(Queue(workers), ClientMeter(), "process", workers)
        return await measure_service(service, LoadPlan((500,), (2.0,), 350.0, 20.0, 64), lambda row: None)

    rows = virtually(work())
    assert [r.sessions for r in rows if r.held]
    assert most <= capacities(rows)[0].sessions <= 5 * workers
    assert all(not r.held for r in rows if r.sessions > 5 * workers)


def test_sessions_stay_from_one_measurement_to_the_next_and_their_frames_are_in_order():
    async def work():
        queue = Queue(4, 0.01)
        plan = LoadPlan((100, 200), (1.0, 2.0), 500.0, 5.0, 4)
        rows = await measure_service(Service(queue, ClientMeter(), "process", 4), plan, lambda row: None)
        return queue, rows

    queue, rows = virtually(work())
    assert queue.begun == 8
    assert [r.sessions for r in rows] == [1, 2, 4] * 4
    for session in {name for name, _ in queue.seen}:
        indices = [index for name, index in queue.seen if name == session]
        assert indices == list(range(len(indices)))


def test_sessions_are_not_in_step():
    """Some frames of a session search the whole space, and take longest."""
    clients = virtually(Fleet(Queue(4, 0.01), 100, 4).grow(20))
    assert [client.next_index for client in clients] == list(range(4, 24))


def test_time_counts_from_when_a_frame_was_due():
    """One session at 10 frames/s, each of which takes 0.2 s: the k-th waits for all before it."""
    tally = virtually(send_to(Queue(1, 0.2), 10.0, 1.0))
    assert tally.seconds == pytest.approx([0.2, 0.3, 0.4, 0.5, 0.6])
    assert tally.late == 5
    assert tally.frames_per_s == pytest.approx(5.0)


def test_refused_frames_are_counted_and_sent_again():
    queue = Queue(1, 0.25, most_waiting=0)
    tally = virtually(send_to(queue, 4.0, 1.0))
    assert (tally.refused, tally.seconds, tally.sent_bytes) == (4, [], 40)
    assert tally.percentile_ms(99) == float("inf")
    assert cost_per_frame(Usage(), tally) == Cost()


async def send_to(queue, rate_hz, seconds):
    return await send(queue, [Client("one")], rate_hz, seconds)


def test_warm_up_goes_on_until_the_frames_are_taken():
    async def work():
        client = Client("one")
        await warm(Queue(1, 0.1), client, 3)
        return client.next_index

    assert virtually(work()) == 3


@pytest.mark.parametrize("limit", [0, 1, 2, 3, 7, 16, 30, 31, 32, 100])
def test_climbs_to_the_limit(limit):
    async def measure(n):
        return row(n, held=n <= limit)

    rows = asyncio.run(climb(measure, 32))
    found = max((r.sessions for r in rows if r.held), default=0)
    assert limit - max(1, limit / 8) <= found <= limit or found == 32
    assert len({r.sessions for r in rows}) == len(rows)


def test_cost_is_per_frame_and_unknown_stays_unknown():
    used = Usage(1.0, 3.0, None, 60.0, 2000.0, None) - Usage(0.5, 1.0, None, 0.0, 1000.0, 7.0)
    tally = Tally([0.1] * 10, sent_bytes=500, received_bytes=200)
    assert cost_per_frame(used, tally) == Cost(50.0, 200.0, None, 6.0, 100.0, None, 50.0, 20.0)


def test_document_and_tables_hold_what_was_measured():
    rows = [row(4, held=True), row(8, held=False, p99_ms=float("inf")), row(7, held=True, workers=2, frames_per_s=18.0)]
    document = load_document({"cpu": "x"}, LoadPlan(), rows)
    assert set(document["rows"][0]) >= CONTRACT
    assert document["rows"][1]["p99_ms"] is None
    assert [(r["workers"], r["sessions"], r["speedup"]) for r in document["capacity"]] == [(1, 4, 1.0), (2, 7, 1.8)]
    assert capacity_table(LoadPlan(), rows).row_count == cost_table(rows).row_count == 2
    assert "too much" in row_line(rows[1])
    pytest.importorskip("matplotlib")
    assert len(load_plot(rows, 500.0, "here").axes[0].lines) == 6


def test_frames_go_there_and_back():
    assert [SCENE.frame(k) for k in range(6)] == [b"zero", b"one", b"two", b"one", b"zero", b"one"]


def answering(status):
    """A service that answers frames with ``status``, over HTTP without a socket."""

    def answer(request):
        if request.method == "PUT":
            return httpx.Response(status, text="{}")
        return httpx.Response(200, json={"model_id": "m", "session_id": "s", "settings": {}})

    return HttpTarget("http://service", "secret", SCENE, httpx.MockTransport(answer))


@pytest.mark.parametrize(("status", "taken"), [(200, True), (429, False), (503, False)])
def test_http_answers_and_refusals(status, taken):
    async def work():
        async with answering(status) as target:
            answer = await target.frame(await target.begin(100, 1), 1)
            await target.end()
            return answer

    answer = asyncio.run(work())
    assert answer.taken is taken
    assert answer.sent_bytes > len(SCENE.frame(1)) + len("PUT/v1/sessions/s/frames/1")


def test_any_other_answer_ends_the_measurement():
    async def work():
        async with answering(500) as target:
            await send(target, [Client("a"), Client("b")], 10.0, 5.0)

    with pytest.raises(LoadError, match="500"):
        virtually(work())


def test_computing_time_of_a_process_and_what_it_started():
    if not os.path.isdir("/proc/self"):  # noqa: PTH112
        pytest.skip("no /proc")
    script = "import subprocess, sys; subprocess.run([sys.executable, '-c', 'input()'])"
    with subprocess.Popen([sys.executable, "-c", script], stdin=subprocess.PIPE) as process:
        while not list(descendants(process.pid)):
            assert process.poll() is None
        assert process.pid in set(descendants(os.getpid()))
        process.communicate(b"\n")
    assert cpu_s(os.getpid()) > 0
    assert cpu_s(2**22 + 1) == 0


def test_sqlite_counts_rows_and_pages_in_use(tmp_path):
    file = tmp_path / "skypose.sqlite3"
    tables = ("frames", "frame_bodies", "estimates", "particles", "beliefs", "events")
    with sqlite3.connect(file) as connection:
        for table in tables:
            connection.execute(f"CREATE TABLE {table} (session_id TEXT, idx INTEGER, data BLOB)")
        rows = [("one", 0), ("one", 1), ("two", 0)]
        for table in tables:
            connection.executemany(f"INSERT INTO {table} VALUES (?, ?, zeroblob(10000))", rows)
    before = SqliteCounters(file).read(os.getpid())
    with sqlite3.connect(file) as connection:  # a frame, and an old one goes
        connection.execute("INSERT INTO frame_bodies VALUES ('one', 2, NULL)")
        connection.execute("DELETE FROM frame_bodies WHERE idx < 2")
    after = SqliteCounters(file).read(os.getpid())
    assert before.rows == 18
    assert 18 * 10_000 < before.size_bytes < 300_000
    assert after.size_bytes < before.size_bytes - 20_000
    assert after.rows == 18 + 1 - 1  # of session two nothing is left there


@pytest.mark.long
def test_a_real_service_is_measured(tmp_path):
    small = ["--particles", "60", "--size", "64x64", "--rate", "0.5", "--seconds", "2", "--most-sessions", "1"]
    out = tmp_path / "rows.json"
    result = CliRunner().invoke(app, ["bench", "load", *small, "--bound-ms", "60000", "--json", str(out)], env=WIDE)
    assert result.exit_code == 0, result.output
    document = json.loads(out.read_text())
    assert [r["sessions"] for r in document["rows"]] == [1]
    for found in document["rows"]:
        assert found["rows"] == 6.0  # frame, body, estimate, particles, belief, event
        assert found["sent_bytes"] > 1000
        assert found["database_bytes"] > 1000
        assert found["worker_cpu_ms"] > 0


def test_what_cannot_be_reached_is_told_in_a_line():
    result = CliRunner().invoke(app, ["bench", "load", "--url", "http://127.0.0.1:9", "--size", "64x64"], env=WIDE)
    assert result.exit_code == 1
    assert "Traceback" not in result.output
