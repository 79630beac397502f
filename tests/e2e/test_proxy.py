"""The cluster's proxy before two real web processes on one PostgreSQL: TLS, keys, streams, and a process that dies."""

import os
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import httpx
import pytest
from fake_worker import CUBE
from passes import fake_pass
from postgres_server import Postgres
from server_process import Server

from service.client import Client

WORKER = "fake_worker:FakeWorker"
KEY = "a" * 64
START_LIMIT_S = 60.0
FRAMES = 6


@pytest.fixture(scope="module")
def processes(tmp_path_factory: pytest.TempPathFactory, postgres: Postgres) -> Iterator[list[Server]]:
    """Two of them, which know a key."""
    if shutil.which("caddy") is None:
        pytest.skip("caddy is not installed")
    folder = tmp_path_factory.mktemp("processes")
    (folder / "admin_key").write_text(KEY)
    settings = {
        "database_url": postgres.database(),
        "auth": "required",
        "bootstrap_key_file": folder / "admin_key",
        "log_level": "error",
    }
    servers = [Server(folder / name, worker=WORKER, **settings) for name in ("one", "two")]
    with ExitStack() as stack:
        for server in servers:
            server.start()
            stack.callback(server.stop)
        yield servers


@pytest.fixture(scope="module")
def address(root: Path, processes: list[Server], tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Where the proxy takes calls. Its configuration is the cluster's but for addresses and ports."""
    folder = tmp_path_factory.mktemp("proxy")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    text = (root / "deploy" / "cluster" / "Caddyfile").read_text()
    upstreams = " ".join(f"127.0.0.1:{server.port}" for server in processes)
    assert "web-1:8000 web-2:8000" in text
    text = text.replace("web-1:8000 web-2:8000", upstreams)
    text = text.replace("skip_install_trust", "skip_install_trust\n\tadmin off\n\tauto_https disable_redirects")
    (folder / "Caddyfile").write_text(text)
    own = {"HOME": str(folder), "XDG_DATA_HOME": str(folder), "XDG_CONFIG_HOME": str(folder)}
    environment = {**os.environ, **own, "DOMAIN": f"localhost:{port}"}
    command = ["caddy", "run", "--config", str(folder / "Caddyfile"), "--adapter", "caddyfile"]
    authority = folder / "caddy" / "pki" / "authorities" / "local" / "root.crt"
    with (folder / "log").open("wb") as log, pytest.MonkeyPatch.context() as patch:
        process = subprocess.Popen(command, env=environment, stdout=log, stderr=subprocess.STDOUT)
        try:
            patch.setenv("SSL_CERT_FILE", str(authority))  # httpx and websockets both go by it
            wait_until_ready(f"https://localhost:{port}", authority, process, folder / "log")
            yield f"https://localhost:{port}"
        finally:
            process.kill()  # asked to end, it would wait for the streams
            process.wait()


def wait_until_ready(url: str, authority: Path, process: "subprocess.Popen[bytes]", log: Path) -> None:
    until = time.monotonic() + START_LIMIT_S
    while process.poll() is None and time.monotonic() < until:
        try:
            if authority.exists() and httpx.get(f"{url}/readyz").status_code == httpx.codes.OK:
                return
        except httpx.TransportError:
            pass  # no certificate yet
        time.sleep(0.05)
    pytest.fail(f"no proxy:\n{log.read_text(errors='replace')[-3000:]}")


def test_a_track_and_its_stream_go_through_while_a_process_dies(address: str, processes: list[Server]) -> None:
    given = fake_pass(FRAMES)
    with Client(address, api_key=KEY) as client:
        model = client.upload_model(CUBE, file_name="cube.glb").model_id
        session = client.create_session(model).session_id
        client.add_background(session, given.background[0], "image/png")
        for index, image in enumerate(given.frames[: FRAMES // 2]):
            assert client.put_frame(session, index, image, "image/png").index == index
        processes[0].kill()
        for index, image in enumerate(given.frames[FRAMES // 2 :], FRAMES // 2):
            assert client.put_frame(session, index, image, "image/png").index == index
        for over in ("websocket", "sse"):
            seen = []
            for event in client.watch(session, after=0, over=over):
                seen.append(event.estimate.index)
                if len(seen) == FRAMES:
                    break
            assert seen == list(range(FRAMES))


def test_the_proxy_speaks_tls_only_and_keys_are_asked_for(address: str) -> None:
    assert httpx.get(f"{address}/v1/sessions").status_code == httpx.codes.UNAUTHORIZED
    assert httpx.get(f"{address}/", headers={"Origin": address}).status_code == httpx.codes.OK
    foreign = httpx.get(f"{address}/v1/sessions", headers={"Origin": "https://elsewhere.example"})
    assert foreign.status_code == httpx.codes.FORBIDDEN
    plain = httpx.get(address.replace("https:", "http:"))
    assert plain.status_code == httpx.codes.BAD_REQUEST
