"""The compose files: valid by the specification's schema, hardened, and complete."""

import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

FILES = ["compose.yaml", "compose.cluster.yaml", "compose.nvidia.yaml"]
WHOLE = FILES[:2]  # the third goes on top of the first


def services(root: Path, name: str) -> dict[str, dict[str, Any]]:
    """By name, with the shared parts merged in."""
    found: dict[str, dict[str, Any]] = yaml.safe_load((root / "deploy" / name).read_text())["services"]
    return found


def test_are_valid_by_the_specification(root):
    pytest.importorskip("check_jsonschema")
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.compose-spec"]
    checked = subprocess.run(
        [*command, *(str(root / "deploy" / name) for name in FILES)], capture_output=True, text=True, timeout=60
    )
    assert checked.returncode == 0, checked.stdout + checked.stderr


@pytest.mark.parametrize("name", WHOLE)
def test_every_container_is_hardened(root, name):
    for service, found in services(root, name).items():
        assert found["read_only"] is True, service
        assert found["cap_drop"] == ["ALL"], service
        assert "no-new-privileges:true" in found["security_opt"], service
        assert set(found.get("cap_add", [])) <= {"NET_BIND_SERVICE"}, service
        assert any(str(place).startswith("/tmp") for place in found.get("tmpfs", [])) or service == "proxy"


@pytest.mark.parametrize("name", WHOLE)
def test_every_image_has_a_health_check_and_a_version(root, name):
    for service, found in services(root, name).items():
        if "build" in found:
            continue  # the Dockerfile has one
        assert "healthcheck" in found, service
        tag = found["image"].partition(":")[2]
        assert tag[:1].isdigit() or tag[:1] == "v", service


def test_files_and_volumes_that_are_mounted_are_there(root):
    document = yaml.safe_load((root / "deploy" / "compose.cluster.yaml").read_text())
    for service, found in document["services"].items():
        for mount in found.get("volumes", []):
            source = mount.partition(":")[0]
            there = (root / "deploy" / source).is_file() if source.startswith(".") else source in document["volumes"]
            assert there, f"{service}: {source}"
        assert set(found.get("networks", [])) <= set(document["networks"])
        assert set(found.get("secrets", [])) <= set(document["secrets"])


def test_secrets_are_files_that_one_command_makes(root, tmp_path):
    shutil.copy(root / "deploy" / "make-secrets", tmp_path)
    subprocess.run([tmp_path / "make-secrets"], check=True, capture_output=True)
    made = {path.name: path.read_text() for path in (tmp_path / "secrets").iterdir()}
    secrets = yaml.safe_load((root / "deploy" / "compose.cluster.yaml").read_text())["secrets"]
    assert {Path(secret["file"]).name for secret in secrets.values()} == set(made)
    assert {len(text) for text in made.values()} == {64}
    assert len(set(made.values())) == len(made)
    assert stat.S_IMODE((tmp_path / "secrets").stat().st_mode) == 0o700

    subprocess.run([tmp_path / "make-secrets", "admin_key"], check=True, capture_output=True)
    changed = {path.name for path in (tmp_path / "secrets").iterdir() if path.read_text() != made[path.name]}
    assert changed == {"admin_key"}
    assert subprocess.run([tmp_path / "make-secrets", "nothing"], capture_output=True).returncode == 2
    ignored = (root / ".gitignore").read_text().splitlines()
    assert "/deploy/secrets/" in ignored


def test_the_database_address_is_put_together_inside(root, tmp_path):
    web = services(root, "compose.cluster.yaml")["web-1"]
    (tmp_path / "database_password").write_text("abc123")
    words = [word.replace("$$", "$").replace("/run/secrets", str(tmp_path)) for word in web["entrypoint"]]
    told = subprocess.run(
        [*words, "sh", "-c", 'echo "$SKYPOSE_DATABASE_URL $1"', "name", "an argument"],
        env={"PATH": os.environ["PATH"]},
        capture_output=True,
        text=True,
        check=True,
    )
    assert told.stdout == "postgresql+psycopg://skypose:abc123@postgres/skypose an argument\n"


def test_web_processes_differ_in_their_address_only(root):
    found = services(root, "compose.cluster.yaml")
    one, two = found["web-1"], found["web-2"]
    for name, service in (("web-1", one), ("web-2", two)):
        assert service["environment"]["SKYPOSE_INSTANCE_URL"] == f"http://{name}:8000"
        assert f"{name}:8000" in (root / "deploy" / "cluster" / "Caddyfile").read_text()
        assert f"{name}:8000" in (root / "deploy" / "cluster" / "prometheus.yml").read_text()
    same = {"environment", "volumes"}
    assert {key: one[key] for key in one.keys() - same} == {key: two[key] for key in two.keys() - same}


def test_caddy_takes_its_configuration(root, tmp_path):
    caddy = shutil.which("caddy")
    if caddy is None:
        pytest.skip("caddy is not installed")
    file = root / "deploy" / "cluster" / "Caddyfile"
    home = {"PATH": os.environ["PATH"], "HOME": str(tmp_path), "XDG_DATA_HOME": str(tmp_path)}
    checked = subprocess.run(
        [caddy, "validate", "--config", str(file), "--adapter", "caddyfile"],
        env=home,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert checked.returncode == 0, checked.stderr
