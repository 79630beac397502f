"""A Ray cluster of several nodes on this machine, whose nodes and actors can be killed."""

import contextlib
import os
import signal
import time
from collections.abc import Iterator
from typing import Any

import httpx
from server_process import ROOT, Server

os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # before Ray is imported, which reads it

STORE_BYTES = 100 << 20


class LocalCluster:
    """A head that runs nothing, and nodes of one core each."""

    def __init__(self, nodes: int) -> None:
        from ray.cluster_utils import Cluster

        # What runs on the nodes imports the service and the fake workers.
        self._before = os.environ.get("PYTHONPATH")
        os.environ["PYTHONPATH"] = os.pathsep.join(str(ROOT / name) for name in (".", "tests", "tests/e2e"))
        head = {"num_cpus": 0, "object_store_memory": STORE_BYTES, "include_dashboard": False}
        self._cluster = Cluster(initialize_head=True, head_node_args=head)
        self.address: str = self._cluster.address
        self.nodes: list[Any] = []
        for _ in range(nodes):
            self.add_node()

    def add_node(self) -> None:
        """One more node."""
        self.nodes.append(self._cluster.add_node(num_cpus=1, object_store_memory=STORE_BYTES, wait=True))

    def kill_node(self, node: Any) -> None:
        """All of a node's processes at once, as if its machine had lost power."""
        self.nodes.remove(node)
        self._cluster.remove_node(node, allow_graceful=False)

    def close(self) -> None:
        """End every node."""
        self._cluster.shutdown()
        if self._before is None:
            del os.environ["PYTHONPATH"]
        else:
            os.environ["PYTHONPATH"] = self._before


def actors(server: Server) -> list[dict[str, Any]]:
    """The actors that are ready, as the service shows them; none where it is answered 503 for want of any."""
    answer = httpx.get(f"{server.url}/v1/system", timeout=150)  # it waits for an actor that is on its way
    found = [] if answer.status_code == 503 else answer.raise_for_status().json()["workers"]
    return [actor for actor in found if actor["ready"]]


def busy_actor(server: Server) -> dict[str, Any]:
    """The actor where the sessions live; waits until there is one."""
    while not (ready := actors(server)):
        time.sleep(0.05)  # not a wait for a result: an actor is on its way
    return max(ready, key=lambda actor: actor["sessions"])


def kill_actor(actor: dict[str, Any]) -> None:
    """SIGKILL to the actor's process."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(actor["pid"], signal.SIGKILL)


def node_of(cluster: LocalCluster, actor: dict[str, Any]) -> Any:
    """The node that an actor is on."""
    return next((node for node in cluster.nodes if node.node_id == actor["node"]), None)


@contextlib.contextmanager
def ray_cluster(nodes: int) -> Iterator[LocalCluster]:
    """A cluster for a while."""
    cluster = LocalCluster(nodes)
    try:
        yield cluster
    finally:
        cluster.close()
