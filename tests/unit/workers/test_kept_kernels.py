"""Kernels that frames build are kept while the worker lives: one that is killed has no last moment to do it in."""

import math

import pytest
from demo_jobs import DemoPass

from gpu.kernel_cache import KernelCache
from service.workers import tracker as tracker_module
from service.workers.tracker import Tracker
from service.workers.warm_up import build_kernels


@pytest.mark.parametrize(("long_ms", "kept"), [(0.0, 3), (math.inf, 0)])
def test_they_are_kept_after_a_frame_that_took_long(monkeypatch, tmp_path, long_ms, kept):
    moments = []
    monkeypatch.setattr(tracker_module, "LONG_MS", long_ms)
    monkeypatch.setattr(KernelCache, "keep", lambda _: moments.append(True))
    tracker = Tracker(kernels=KernelCache(tmp_path))
    DemoPass().track(tracker, "cpu")
    assert len(moments) == kept
    tracker.close()


def test_a_worker_that_is_ended_over_its_start_has_not_built_in_vain():
    moments = []
    build_kernels(lambda: moments.append(True))
    assert len(moments) == 3
