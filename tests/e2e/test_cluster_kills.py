"""The short form of the cluster's kill loop; the long one is a command (docs/cluster.md)."""

import pytest
from cluster_loop import good, run

pytestmark = [pytest.mark.timeout(600), pytest.mark.long]


def test_two_web_processes_lose_nothing_under_kills(postgres):
    figures = run(kills=3, minutes=8, n_sessions=2, seed=3, postgres=postgres, lease_s=1.0)
    assert good(figures), figures
    assert figures["owners_paused"] and figures["database_restarts"] and figures["moves"], figures
