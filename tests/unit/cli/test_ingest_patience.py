"""A folder is followed on while the service is away."""

import os

import httpx
import pytest
from remote_answers import estimate

from service.cli.ingest import Ingest
from service.cli.ingest_session import SessionPlan
from service.client import Client, Retries

MISSING = {"type": "urn:skypose:problem:not-found", "status": 404, "detail": "no such key"}


class EnoughError(Exception):
    """Ends an endless loop."""


def test_files_wait_for_a_service_that_is_away(tmp_path):
    path = tmp_path / "frame.png"
    path.write_bytes(b"png")
    os.utime(path, (1e9, 1e9))
    calls, naps = [], []

    def answer(request: httpx.Request) -> httpx.Response:
        calls.append(request.method)
        if len(calls) <= 2:
            raise httpx.ConnectError("down")
        return httpx.Response(404, json=MISSING) if request.method == "GET" else httpx.Response(200, json=estimate(0))

    def sleep(seconds: float) -> None:
        naps.append(seconds)
        if len(naps) == 4:
            raise EnoughError

    with Client("http://pose", transport=httpx.MockTransport(answer), retries=Retries(attempts=1)) as client:
        run = Ingest(client, tmp_path, SessionPlan(None), "s", tmp_path / "note", file_times=False, as_json=False)
        with pytest.raises(EnoughError):
            run.follow(once=False, settle_s=1.0, poll_s=0.5, now=lambda: 2e9, sleep=sleep)
    assert (calls, run.tracked, naps) == (["GET"] * 3 + ["POST"], 1, [0.5] * 4)
