"""Clients that other people's generators make: nothing is dropped, and a session is begun and tracked with them."""

import asyncio
import importlib
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from api_client import image, served
from fake_worker import CUBE

from service.cli.openapi import openapi_text

HERE = Path(__file__).resolve().parent
CONFIG = HERE.parents[1] / "docs" / "examples" / "openapi-python-client.yaml"
UNREACHABLE = ("ENOTFOUND", "ETIMEDOUT", "ECONNREFUSED", "EAI_AGAIN", "NewConnectionError", "ConnectTimeoutError")


@pytest.fixture(scope="module")
def description(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("generated") / "openapi.json"
    path.write_text(openapi_text())
    return path


def operations(description: Path) -> set[str]:
    paths = json.loads(description.read_text())["paths"].values()
    return {operation["operationId"] for path in paths for operation in path.values()}


def done(folder: Path, *command: object, **environment: str) -> str:
    """Output of a command; the test fails with all that it told if it fails."""
    told, code = tried(folder, *command, **environment)
    assert code == 0, told
    return told


def tried(folder: Path, *command: object, **environment: str) -> tuple[str, int]:
    """All that a command tells, and how it ends."""
    words, variables = [str(word) for word in command], {**os.environ, **environment}
    ended = subprocess.run(words, cwd=folder, env=variables, capture_output=True, text=True, timeout=120)
    return ended.stdout + ended.stderr, ended.returncode


def fetched(folder: Path, *command: object) -> None:
    """Run a command that fetches packages; skips the test where no index can be reached."""
    told, code = tried(folder, *command)
    if code and any(word in told for word in UNREACHABLE):
        pytest.skip(f"{command[0]} reaches no index of packages")
    assert code == 0, told


@pytest.fixture(scope="module")
def generated_python(description: Path) -> Path:
    """The folder of a package ``generated_skypose``; any warning of the generator is an error."""
    folder = description.parent
    install = ("-m", "pip", "install", "--quiet", "--no-deps", "--require-hashes", "--target", folder / "generator")
    fetched(folder, sys.executable, *install, "--retries", 1, "-r", HERE / "generated" / "requirements.txt")
    (folder / "config.yaml").write_text(CONFIG.read_text() + "post_hooks: []\n")  # which only lay the code out
    generate = (sys.executable, "-m", "openapi_python_client", "generate", "--fail-on-warning", "--meta", "none")
    told = ("--path", description, "--config", "config.yaml", "--output-path", "generated_skypose")
    done(folder, *generate, *told, PYTHONPATH=str(folder / "generator"))
    return folder / "generated_skypose"


def test_python_has_every_operation(description, generated_python):
    assert {path.stem for path in generated_python.glob("api/*/*.py")} - {"__init__"} == operations(description)


@pytest.mark.anyio
async def test_python_tracks(make_app, generated_python, monkeypatch):
    monkeypatch.syspath_prepend(generated_python.parent)

    def part(name: str) -> ModuleType:
        return importlib.import_module(f"generated_skypose.{name}")

    models, types = part("models"), part("types")

    def track(client: Any) -> None:
        def call(name: str, *arguments: object, **options: object) -> Any:
            return part(f"api.{name}").sync(*arguments, client=client, **options)

        upload = models.UploadModelBody(file=types.File(payload=CUBE, file_name="cube.glb"))
        model = call("models.upload_model", body=upload)
        here = call(
            "sessions.create_session", body=models.CreateSessionSessionRequest(model_id=model.model_id)
        ).session_id
        sky = call("frames.add_background", here, body=types.File(payload=image()))
        assert (sky.background_frames, sky.state) == (1, "ready")
        frames = [call("frames.put_frame", here, k, body=types.File(payload=image(k + 1))) for k in range(2)]
        told = call("estimates.list_estimates", here)
        assert [estimate.to_dict() for estimate in told.estimates] == [frame.to_dict() for frame in frames]
        assert call("estimates.read_overlay", here, 0).payload.read().startswith(b"\x89PNG")
        key = call(
            "access.create_key", body=models.CreateKeyKeyRequest(name="mine", role=models.CreateKeyKeyRequestRole.READ)
        )
        assert [one.name for one in call("access.list_keys").keys] == [key.name] == ["mine"]
        refused = call("frames.put_frame", here, 9, body=types.File(payload=image(1)))
        assert refused.type_ == "urn:skypose:problem:frame-gap"

    def begin(url: str) -> None:
        with part("client").Client(base_url=url, raise_on_unexpected_status=True) as client:
            track(client)

    async with served(make_app()) as host:
        await asyncio.to_thread(begin, f"http://{host}")


@pytest.fixture(scope="module")
def generated_typescript(description: Path) -> Path:
    """A folder with ``schema.d.ts``, the client that uses it, and what both need of npm."""
    if shutil.which("npm") is None:
        pytest.skip("npm is not installed")
    folder = description.parent
    for file in (HERE / "generated").iterdir():
        shutil.copy(file, folder)
    fetched(folder, "npm", "ci", "--no-audit", "--no-fund", "--fetch-retries=0")
    told = done(folder, "node_modules/.bin/openapi-typescript", description, "-o", "schema.d.ts")
    assert "warn" not in told.lower()
    return folder


def test_typescript_has_every_operation(description, generated_typescript):
    text = (generated_typescript / "schema.d.ts").read_text()
    _, found, after = text.partition("export interface operations {")
    assert found and set(re.findall(r"^    (\w+): \{$", after, flags=re.M)) == operations(description)


@pytest.mark.anyio
async def test_typescript_tracks(make_app, generated_typescript):
    folder = generated_typescript
    (folder / "cube.glb").write_bytes(CUBE)
    (folder / "image.png").write_bytes(image(1))
    async with served(make_app()) as host:
        checked = asyncio.to_thread(done, folder, "node_modules/.bin/tsc")
        called = asyncio.to_thread(done, folder, "node", "call_service.mjs", f"http://{host}", "cube.glb", "image.png")
        _, text = await asyncio.gather(checked, called)
    told = json.loads(text)
    assert (told["time"], told["frames"]) == ("2026-11-20T03:04:05.000Z", 1) and 0 < told["w"][0] <= 1
