"""Workers as Ray actors on a cluster of two nodes: what an actor or a node takes along is never a frame."""

import asyncio
import os
import subprocess
import sys

import httpx
import pytest
from passes import PNG, begin, comparable, fake_pass, history
from server_process import ROOT, Server

from service.errors import ConfigError, ImageError, MissingBlobError, WorkerFailedError
from service.settings import Settings
from service.workers.child_process import Program
from service.workers.transports import open_transport

pytestmark = [pytest.mark.timeout(600), pytest.mark.filterwarnings("default")]  # Ray leaves sockets to the collector
FRAMES = 12


@pytest.fixture(scope="module")
def cluster():
    pytest.importorskip("ray", reason="Ray is not installed (pip install ray)")
    from ray_cluster import ray_cluster

    with ray_cluster(2) as cluster:
        yield cluster


@pytest.fixture
def server(tmp_path):
    servers = []

    def make(name: str, **settings) -> Server:
        servers.append(Server(tmp_path / name, **settings))
        servers[-1].start()
        return servers[-1]

    yield make
    for server in servers:
        server.stop()


def test_actors_answer_refuse_and_are_replaced(cluster, tmp_path):
    from service.workers.ray_engine import RayPlan, RayTransport
    from service.workers.ray_worker import WorkerPlan

    async def talk():
        worker = WorkerPlan(Program("odd_worker:Odd"), 1, 60.0, "off", 1)
        transport = RayTransport(RayPlan(cluster.address, 2, 1, 120.0), worker)
        await transport.start()
        try:
            pids = {await transport.call("s", "overlay", "pid") for _ in range(3)}
            assert len(pids) == 1 and os.getpid() not in pids
            with pytest.raises(ImageError) as refusal:
                await transport.call("s", "overlay", "refuse")
            assert (refusal.value.field, refusal.value.facts) == ("body", {"limit": 3})
            with pytest.raises(MissingBlobError):
                await transport.call("s", "overlay", "missing")
            assert transport.restarts == 0
            # A large job goes by reference, and both runs of it read the same object.
            pid = await transport.call("s", "overlay", ("once", str(tmp_path / "marks"), b"x" * 200_000))
            assert pid not in pids
            assert transport.restarts == 1
            with pytest.raises(WorkerFailedError):
                await transport.call("s", "overlay", "die")
            assert transport.restarts == 1  # the job's fault: no actor is given up for it
            assert await transport.call("s", "overlay", "pid")
            names = [actor["name"] for actor in transport.processes()]
            assert names == ["track-0", "track-1"]
        finally:
            await transport.close()

    asyncio.run(talk())


@pytest.mark.long
def test_lost_actors_and_nodes_lose_no_frame(cluster, server):
    """An actor is killed in the middle of one frame, its successor's node in the middle of another, and one comes."""
    from ray_cluster import actors, busy_actor, kill_actor, node_of

    given = fake_pass(FRAMES)
    calm = server("calm", worker="fake_worker:FakeWorker")
    with httpx.Client(base_url=calm.url, timeout=120) as http:
        session_id = begin(http, given, name="body.glb")
        for n, image in enumerate(given.frames):
            http.put(f"/v1/sessions/{session_id}/frames/{n}", content=image, headers=PNG).raise_for_status()
        expected = history(http, session_id)
    chosen = {"engine": "ray", "ray_address": cluster.address, "ray_actors": 2}
    target = server("ray", worker="fake_worker:SlowWorker", **chosen)
    acknowledged, moved = [], set()
    with httpx.Client(base_url=target.url, timeout=120) as http:
        session_id = begin(http, given, name="body.glb")
        for n, image in enumerate(given.frames):
            home = busy_actor(target)
            if n == 3:
                kill_actor(home)
            if n == 7:
                cluster.kill_node(node_of(cluster, home))
                cluster.add_node()
            answer = http.put(f"/v1/sessions/{session_id}/frames/{n}", content=image, headers=PNG).raise_for_status()
            acknowledged.append(comparable(answer.json()))
            moved.add(busy_actor(target)["pid"])
        assert history(http, session_id) == acknowledged == expected
        assert len(moved) >= 3
        assert all({"actor", "node", "memory_mb", "load", "sessions"} <= set(actor) for actor in actors(target))
        session = http.get(f"/v1/sessions/{session_id}").json()
    assert (session["frames"], session["last_seq"]) == (FRAMES, FRAMES)


def test_nothing_of_ray_is_imported_unless_chosen():
    program = "import sys, service.main, service.cli.serve, service.workers.transports; sys.exit('ray' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], cwd=ROOT).returncode == 0


def test_ray_that_is_not_installed_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.delitem(sys.modules, "service.workers.ray_engine", raising=False)
    with pytest.raises(ConfigError, match=r"pip install 'ray"):
        open_transport(Settings(engine="ray").model_dump())
