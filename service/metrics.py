"""Prometheus metrics, one registry per application."""

from __future__ import annotations

import math
from collections.abc import Mapping

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram

_SECONDS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0)


class Metrics:
    """What an operator watches."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self.frames = Counter(
            "skypose_frames_total",
            "Frames tracked, by status of the estimate",
            ["status"],
            registry=self.registry,
        )
        self.duplicates = Counter(
            "skypose_duplicate_frames_total", "Frames answered from the store", registry=self.registry
        )
        self.refusals = Counter(
            "skypose_refusals_total", "Calls refused, by type of problem", ["type"], registry=self.registry
        )
        self.stage_seconds = Histogram(
            "skypose_stage_seconds",
            "Time of a frame in each stage: wait, decode, measure, score, total, commit",
            ["stage"],
            buckets=_SECONDS,
            registry=self.registry,
        )
        self.request_seconds = Histogram(
            "skypose_request_seconds",
            "Time of HTTP calls",
            ["method", "route", "status"],
            buckets=_SECONDS,
            registry=self.registry,
        )
        self.ess_share = Histogram(
            "skypose_ess_share",
            "Effective sample size over particles",
            buckets=(0.001, 0.003, 0.01, 0.03, 0.1, 0.2, 0.3, 0.5, 0.7, 0.9, 1.0),
            registry=self.registry,
        )
        self.forwarded = Counter(
            "skypose_forwarded_calls_total",
            "Calls handed on to the process that has the session",
            registry=self.registry,
        )
        self.fenced = Counter(
            "skypose_fenced_frames_total", "Frames not stored, as another took the session", registry=self.registry
        )
        self.retention = Counter(
            "skypose_retention_total", "Sessions ended and deleted by rule", ["action"], registry=self.registry
        )
        self._count_connections()
        self.evictions = Counter("skypose_evictions_total", "Idle sessions that left memory", registry=self.registry)
        self.resident_sessions = self._gauge("skypose_resident_sessions", "Sessions in memory")
        self.waiting_frames = self._gauge("skypose_waiting_frames", "Frames waiting or under way")
        self.waiting_bytes = self._gauge("skypose_waiting_bytes", "Bytes of those frames")
        self.watchers = self._gauge("skypose_watchers", "Open streams")
        self.worker_restarts = self._gauge("skypose_worker_restarts", "Workers lost since the start")
        self.database_bytes = self._gauge("skypose_database_bytes", "Size of the database, its log included")
        self.disk_free_bytes = self._gauge("skypose_disk_free_bytes", "Free on its disk; NaN where it is elsewhere")
        self.disk_free_bytes.set(math.nan)
        self.loop_lag_seconds = self._gauge("skypose_loop_lag_seconds", "Delay of the event loop, newest")

    def _count_connections(self) -> None:
        self.cut_connections = Counter(
            "skypose_cut_connections_total",
            "Connections cut: no head in time, or too many from one address or in all",
            ["reason"],
            registry=self.registry,
        )
        self.connections = self._gauge("skypose_connections", "Open connections")

    def tracked(self, status: str, ess_share: float, timing_ms: Mapping[str, float]) -> None:
        """A frame was tracked; ``timing_ms`` of its stages."""
        self.frames.labels(status).inc()
        self.ess_share.observe(ess_share)
        for stage, value in timing_ms.items():
            self.stage_seconds.labels(stage).observe(value / 1e3)

    def _gauge(self, name: str, text: str) -> Gauge:
        return Gauge(name, text, registry=self.registry)
