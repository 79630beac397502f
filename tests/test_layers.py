"""Imports go one way (docs/architecture.md), and files and functions stay small enough to read."""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
MAX_FILE_LINES = 300
MOST_COLUMNS = 120
MAX_FUNCTION_LINES = 60

# Room -> our rooms it may import, beside itself. "everything" is for the places that wire the others together.
ROOMS: dict[str, set[str]] = {
    "service.main": {"everything"},
    "service.__main__": {"everything"},
    "service.ears": {"access", "sessions", "store", "errors"},
    "service.housekeeping": {"access", "api", "store", "workers", "errors"},
    "service.cli": {"everything"},
    "service.client": {"remote", "api"},
    "service.remote": {"api"},
    "service.api": {"access", "sessions", "exports", "errors", "settings", "metrics", "inference"},
    "service.access": {"store", "errors", "settings"},
    "service.sessions": {
        "workers",
        "store",
        "imaging",
        "inference",
        "attitude",
        "exports",
        "report",
        "errors",
        "metrics",
    },
    "service.workers": {"inference", "imaging", "models", "gpu", "errors"},
    "service.models": {"gpu", "inference", "errors"},
    "service.imaging": {"errors"},
    "service.inference": set(),
    "service.attitude": {"inference", "errors"},
    "service.exports": {"attitude", "inference", "errors"},
    "service.report": {"inference"},
    "service.simulate": {"gpu", "inference", "attitude"},
    "service.bench": {"simulate", "sessions", "workers", "inference", "models", "imaging", "attitude", "gpu"},
    "service.store": {"errors", "settings"},
    "service.errors": set(),
    "service.settings": set(),
    "service.metrics": set(),
    "gpu": set(),
}

# Third-party packages of the rooms that must run anywhere, or know nothing of the rest.
PACKAGES: dict[str, set[str]] = {
    "service.inference": {"numpy", "scipy", "cv2"},
    "service.imaging": {"numpy", "scipy", "cv2", "astropy"},
    "service.attitude": {"numpy", "astropy_iers_data", "erfa", "sgp4", "defusedxml"},
    "service.exports": {"numpy"},
    "service.report": {"numpy", "cv2", "jinja2", "markupsafe"},
    "gpu": {
        "numpy",
        "scipy",
        "pyopencl",
        "moderngl",
        "trimesh",
        "collada",
        "DracoPy",
        "fast_simplification",
        "defusedxml",
    },
    "service.errors": set(),
}


def python_files(*folders: str) -> list[Path]:
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def room_of(module: str) -> str:
    parts = module.split(".")
    return parts[0] if parts[0] != "service" else ".".join(parts[:2])


def imported_modules(tree: ast.AST, path: Path) -> Iterator[str]:
    """Absolute names of what a module imports, anywhere in it: inside functions and under TYPE_CHECKING too."""
    package = [*path.relative_to(ROOT).parent.parts]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            prefix = ".".join([*base, *(node.module or "").split(".")]).strip(".")
            # ``from service import errors`` names a room only together with what it takes.
            yield from (f"{prefix}.{a.name}" if prefix == "service" else prefix for a in node.names)


def wrong_arrows(room: str, modules: set[str]) -> set[str]:
    ours = {room_of(m) for m in modules if m.split(".")[0] in ("service", "gpu")} - {room, "service.__version__"}
    allowed = ROOMS[room]
    wrong = set() if "everything" in allowed else {r for r in ours if r.removeprefix("service.") not in allowed}
    if room in PACKAGES:
        others = {m.split(".")[0] for m in modules} - {"service", "gpu"} - sys.stdlib_module_names
        wrong |= others - PACKAGES[room]
    return wrong


@pytest.mark.parametrize("path", python_files("service", "gpu"), ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_go_one_way(path: Path) -> None:
    module = module_name(path)
    if module == "service":
        assert not set(imported_modules(ast.parse(path.read_text()), path)) - sys.stdlib_module_names
        return
    room = room_of(module)
    assert room in ROOMS, f"{room} is a new room: add it here and to docs/architecture.md"
    wrong = wrong_arrows(room, set(imported_modules(ast.parse(path.read_text()), path)))
    assert not wrong, f"{room} must not import {sorted(wrong)}"


def test_wrong_arrows_are_seen() -> None:
    path = ROOT / "service" / "inference" / "step.py"
    source = "from ..workers import base\nfrom service import errors\nimport gpu.mesh, trimesh\nimport numpy as np\n"
    modules = set(imported_modules(ast.parse(source), path))
    assert wrong_arrows("service.inference", modules) == {"service.workers", "service.errors", "gpu", "trimesh"}


def test_the_documented_arrows_are_these() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text()
    rows = re.findall(r"^\| `([\w/.]+)` \|.*\| ([^|]+) \|$", text, flags=re.M)
    known = {name.removeprefix("service.") for name in ROOMS}
    documented = {}
    for room, may_import in rows:
        words = set(re.findall(r"\w+", may_import))
        documented[room.removesuffix(".py").replace("/", ".")] = words & (known | {"everything"})
    tested = {room: allowed for room, allowed in ROOMS.items() if room in documented}
    assert documented == tested
    assert set(ROOMS) - set(documented) == {"service.__main__", "service.errors", "service.settings"}


@pytest.mark.parametrize("path", sorted((ROOT / "gpu" / "kernels").glob("*.cl")), ids=lambda p: p.name)
def test_lines_of_kernels_are_short(path: Path) -> None:
    assert [line for line in path.read_text().splitlines() if len(line) > MOST_COLUMNS] == []


@pytest.mark.parametrize("path", python_files("service", "gpu", "tests"), ids=lambda p: str(p.relative_to(ROOT)))
def test_files_and_functions_are_short(path: Path) -> None:
    text = path.read_text()
    assert path.stem not in ("utils", "util", "helpers", "misc", "common"), "name a module for what it holds"
    assert text.count("\n") <= MAX_FILE_LINES, "split the file by noun"
    long = [
        f"{node.name} ({node.end_lineno - node.lineno + 1} lines)"
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and node.end_lineno is not None
        and node.end_lineno - node.lineno >= MAX_FUNCTION_LINES
    ]
    assert not long
