"""The lock files hold what pyproject.toml asks for, and nothing about where it was fetched."""

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

RENEW = "renew the locks with deploy/lock"
LOCKS = ["requirements.lock", "requirements-ray.lock", "requirements-dev.lock"]


def pinned(path: Path) -> dict[str, set[str]]:
    """Package -> its versions: one, or one per environment marker."""
    found: dict[str, set[str]] = {}
    for name, version in re.findall(r"^([\w.-]+)==([^ ;\\]+)", path.read_text(), flags=re.M):
        found.setdefault(name, set()).add(version)
    return found


def wanted(root: Path, *, dev: bool) -> list[Requirement]:
    project = tomllib.loads((root / "pyproject.toml").read_text())
    lines = [*project["build-system"]["requires"], *project["project"]["dependencies"]]
    if dev:
        lines += [line for extra in project["project"]["optional-dependencies"].values() for line in extra]
    return [Requirement(line) for line in lines]


@pytest.mark.parametrize("name", ["requirements.lock", "requirements-dev.lock"])
def test_holds_what_the_project_asks_for(root: Path, name: str) -> None:
    locked = pinned(root / name)
    for requirement in wanted(root, dev="dev" in name):
        package = re.sub(r"[-_.]+", "-", requirement.name).lower()
        assert package in locked, f"{package} is not in {name}: {RENEW}"
        assert all(version in requirement.specifier for version in locked[package]), f"{package}: {RENEW}"


def test_all_hold_the_same_versions(root: Path) -> None:
    run, ray, dev = (pinned(root / name) for name in LOCKS)
    assert {package: ray.get(package) for package in run} == run, RENEW
    assert {package: dev.get(package) for package in ray} == ray, RENEW
    assert "ray" in ray.keys() - run.keys()


@pytest.mark.parametrize("name", LOCKS)
def test_every_package_has_hashes_and_no_address(root: Path, name: str) -> None:
    entries = re.split(r"^(?=\S)", (root / name).read_text(), flags=re.M)[1:]
    assert entries
    assert all("--hash=sha256:" in entry for entry in entries)
    assert "://" not in (root / name).read_text()
