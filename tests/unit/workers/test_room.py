"""How many workers fit: the least of the cores, a control group's share of them, and memory."""

import os

import pytest

from service.workers import room
from service.workers.room import WORKER_BYTES, cores, memory_bytes, workers_that_fit

OURS = len(os.sched_getaffinity(0))


@pytest.fixture
def groups(tmp_path):
    """Control groups of a unit within a slice, and the file that names the process's own."""
    unit = tmp_path / "groups/system.slice/unit"
    unit.mkdir(parents=True)
    own = tmp_path / "own"
    own.write_text("1:name=systemd:/elsewhere\n0::/system.slice/unit\n")
    return unit, own, tmp_path / "groups"


def test_without_control_groups_the_machine_is_all_there_is(tmp_path):
    assert cores(tmp_path / "none", tmp_path) == OURS
    assert memory_bytes(tmp_path / "none", tmp_path) == os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


@pytest.mark.parametrize(
    ("quota", "expected"), [("max 100000", OURS), ("100000 100000", 1), ("50000 100000", 1), ("9900000 100000", OURS)]
)
def test_share_of_the_computing_time(groups, quota, expected):
    unit, own, root = groups
    (unit / "cpu.max").write_text(quota + "\n")
    assert cores(own, root) == expected


def test_the_narrowest_of_nested_groups_counts(groups):
    unit, own, root = groups
    (unit / "memory.max").write_text("max\n")
    (unit.parent / "memory.max").write_text(f"{300 << 20}\n")
    (root / "memory.max").write_text(f"{400 << 20}\n")
    (root.parent / "memory.max").write_text("1\n")  # which is none
    assert memory_bytes(own, root) == 300 << 20


@pytest.mark.parametrize(("gib", "expected"), [(0.5, 1), (1, 1), (3.9, 3), (64, 8)])
def test_memory_bounds_the_workers(monkeypatch, gib, expected):
    monkeypatch.setattr(room, "cores", lambda: 8)
    monkeypatch.setattr(room, "memory_bytes", lambda: int(gib * WORKER_BYTES))
    assert workers_that_fit() == expected
