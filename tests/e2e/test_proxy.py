"""The cluster's proxy before two real web processes on one PostgreSQL: TLS, keys, streams, and a process that dies."""

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import httpx
import pytest
import yaml
from fake_worker import CUBE
from image_root import lasting_port
from passes import fake_pass
from postgres_server import Postgres
from server_process import Server

from service.client import Client

WORKER = "fake_worker:FakeWorker"
KEY = "a" * 64
START_LIMIT_S = 60.0
FRAMES = 6

pytestmark = pytest.mark.skipif(shutil.which("caddy") is None, reason="caddy is not installed")


@pytest.fixture(scope="module")
def database_url(postgres: Postgres) -> str:
    """An empty database."""
    return postgres.database()


@pytest.fixture(scope="module")
def processes(tmp_path_factory: pytest.TempPathFactory, database_url: str) -> Iterator[list[Server]]:
    """Two of them, which know a key."""
    folder = tmp_path_factory.mktemp("processes")
    (folder / "admin_key").write_text(KEY)
    settings = {
        "database_url": database_url,
        "auth": "required",
        "bootstrap_key_file": folder / "admin_key",
        "log_level": "error",
    }
    servers = [Server(folder / name, worker=WORKER, **settings) for name in ("one", "two")]
    with ExitStack() as stack, ThreadPoolExecutor() as threads:
        for started, server in [(threads.submit(server.start), server) for server in servers]:
            stack.callback(server.stop)
            started.result()
        yield servers


@pytest.fixture(scope="module")
def address(root: Path, processes: list[Server], tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Where the proxy takes calls. Its configuration is the cluster's but for addresses and ports."""
    folder = tmp_path_factory.mktemp("proxy")
    port = lasting_port()
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


def test_prometheus_is_given_a_key_that_reads_metrics(
    root: Path, processes: list[Server], tmp_path: Path, database_url: str
) -> None:
    services = yaml.safe_load((root / "deploy" / "compose.cluster.yaml").read_text())["services"]
    command = [word.replace("/data/", f"{tmp_path}/") for word in services["metrics-key"]["command"]]
    folder = Path(sys.executable).parent
    environment = {
        **os.environ,
        "PATH": f"{folder}{os.pathsep}{os.environ['PATH']}",
        "SKYPOSE_DATABASE_URL": database_url,
        "SKYPOSE_DATA_DIR": str(tmp_path),
    }
    for _ in range(2):  # the second time there is nothing to do
        subprocess.run(command, env=environment, check=True, timeout=120)
        key = (tmp_path / "metrics").read_text().strip()
        answer = httpx.get(f"{processes[1].url}/metrics", headers={"Authorization": f"Bearer {key}"})
        assert "skypose_frames_total" in answer.raise_for_status().text
    refused = httpx.post(f"{processes[1].url}/v1/sessions", json={}, headers={"Authorization": f"Bearer {key}"})
    assert refused.status_code == httpx.codes.FORBIDDEN


def test_the_proxy_speaks_tls_only_and_keys_are_asked_for(address: str) -> None:
    assert httpx.get(f"{address}/v1/sessions").status_code == httpx.codes.UNAUTHORIZED
    assert httpx.get(f"{address}/", headers={"Origin": address}).status_code == httpx.codes.OK
    foreign = httpx.get(f"{address}/v1/sessions", headers={"Origin": "https://elsewhere.example"})
    assert foreign.status_code == httpx.codes.FORBIDDEN
    plain = httpx.get(address.replace("https:", "http:"))
    assert plain.status_code == httpx.codes.BAD_REQUEST
