"""``skypose serve`` and ``skypose keys`` as an operator uses them: a refused start, a first key, a locked service."""

import json
import os
import subprocess
import sys

import httpx
import pytest
from server_process import ROOT, Server
from typer.testing import CliRunner

from service.cli import app


def keys(*arguments: str) -> str:
    done = CliRunner().invoke(app, ["keys", *arguments])
    assert done.exit_code == 0, done.output
    return done.stdout


def key_of(data: str, tenant: str, role: str) -> dict:
    made = keys("create", "--role", role, "--tenant", tenant, "--name", "e2e", "--data", data, "--json")
    return json.loads(made)


@pytest.fixture
def server(tmp_path):
    server = Server(tmp_path / "data", "fake_worker:FakeWorker", host="0.0.0.0", credential_cache_s=0)
    yield server
    server.stop()


def test_without_a_key_it_does_not_start(tmp_path):
    command = [sys.executable, "-m", "service", "serve", "--host", "0.0.0.0", "--port", "0"]
    environment = {**os.environ, "SKYPOSE_DATA_DIR": str(tmp_path / "data")}
    refused = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=60)
    assert refused.returncode == 2
    assert "refusing to listen on 0.0.0.0 without any key" in refused.stderr
    assert "skypose keys create" in refused.stderr
    assert "Traceback" not in refused.stderr


def test_a_key_opens_it_and_its_end_closes_it(server):
    data = str(server.data)
    first = key_of(data, "acme", "operate")
    server.start()
    late = key_of(data, "other", "read")  # beside the running service
    url = f"{server.url}/v1/me"
    assert httpx.get(url).status_code == 401
    for key, tenant in ((first, "acme"), (late, "other")):
        answer = httpx.get(url, headers={"Authorization": f"Bearer {key['key']}"})
        assert (answer.status_code, answer.json()["tenant"]) == (200, tenant)
    keys("revoke", late["id"], "--data", data)
    assert httpx.get(url, headers={"Authorization": f"Bearer {late['key']}"}).status_code == 401
    listed = json.loads(keys("list", "--data", data, "--json"))
    assert [(key["id"], bool(key["revoked_at"])) for key in listed] == [(first["id"], False), (late["id"], True)]
    assert CliRunner().invoke(app, ["keys", "revoke", "ffffffff", "--data", data]).exit_code == 1
    log = server.log.read_text()
    assert first["key"] not in log
    assert late["key"] not in log
