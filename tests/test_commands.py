"""Every command of the documents is one that can be typed: its program, files, options and values are there.

Those that take seconds are run as well: tests/e2e (documented commands, README, tutorial, client, folders, examples).
"""

import json
import os
import re
import shlex
from pathlib import Path

import pytest
import typer
import yaml

from service.cli import app

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
STANDS_FOR = {"DIR": ".", "/data/tonight": ".", "N": "2", "passes": ".", "mixed": "."}  # what a reader puts there
STARTS = r"^(?:\w+=\S+ )*(?:skypose|\.venv/bin/\w+|python|pytest|docker|kubectl|deploy/[\w-]+)(?: |$)"


def commands(page: Path) -> list[tuple[str, bool]]:
    """Each command of a page on one line, and whether it is a whole one: of a block, not named inside of a sentence."""
    text = page.read_text()
    blocks = re.findall(r"^```bash\n(.*?)^```$", text, flags=re.M | re.S)
    prose = re.sub(r"^```.*?^```$", "", text, flags=re.M | re.S)
    blocks += ["\n".join(re.findall(r"^    (\S.*|  +\S.*)$", part, flags=re.M)) for part in prose.split("\n\n")]
    lines = [(line.strip(), True) for block in blocks for line in re.sub(r"\\\n\s*", "", block).splitlines()]
    lines += [(" ".join(found.split()), False) for found in re.findall(r"`([^`]+)`", prose)]
    return [(line, whole and "…" not in line) for line, whole in lines if re.match(STARTS, line)]


def words_of(command: str) -> list[str]:
    """Its words, without what is set for it alone, what a shell puts in, and what stands for more (…)."""
    plain = re.sub(r"\$\([^)]*\)", "x", re.split(r" [|<>] ", command)[0])
    words = [STANDS_FOR.get(word, word) for word in shlex.split(plain, comments=True) if "…" not in word]
    while re.match(r"\w+=", words[0]):
        words = words[1:]
    return words


def is_skypose(words: list[str], whole: bool) -> None:
    """The command is there and knows the options; a whole one's values are taken. Raises what typer would tell."""
    command = typer.main.get_command(app)
    while words and words[0] in getattr(command, "commands", {}):
        command, words = command.commands[words[0]], words[1:]
    if words[:1] == ["COMMAND"]:
        return
    if whole:
        command.make_context("skypose", list(words))
    known = {option for parameter in command.params for option in parameter.opts} | {"--help"}
    assert {word for word in words if word.startswith("--")} <= known, words
    assert not (hasattr(command, "commands") and words and not words[0].startswith("-")), words


def is_python(words: list[str]) -> None:
    """A script or module of ours that knows these options."""
    module = words[words.index("-m") + 1] if "-m" in words else None
    if module == "pytest":
        return is_pytest(words[words.index("pytest") + 1 :])
    path = ROOT / (module.replace(".", "/") + ".py" if module else words[0])
    if path.name == "evaluate.py":  # of the shared sequences, beside a checkout
        return None
    options = {word for word in words if word.startswith("--")}
    assert options <= set(re.findall(r"--[\w-]+", path.read_text())), path
    return None


def is_pytest(words: list[str]) -> None:
    """Its files are there."""
    for word in words:
        if "/" in word:
            assert (ROOT / word.split("::")[0]).exists(), word


def is_compose(words: list[str]) -> None:
    """The file is there, and has the services that are named."""
    files = [ROOT / words[k + 1] for k, word in enumerate(words) if word in ("-f", "--file")]
    services = {name for file in files for name in yaml.safe_load(file.read_text())["services"]}
    verb = next(k for k, word in enumerate(words) if word in ("up", "exec", "cp", "stop", "start", "ps"))
    named = [word.split(":")[0] for word in words[verb + 1 :] if not word.startswith("-")]
    if words[verb] in ("stop", "start", "up"):
        assert set(named) <= services
    elif words[verb] in ("exec", "cp") and services:
        assert named[0] in services
    if named[1:2] == ["skypose"]:
        is_skypose(words[words.index("skypose", verb + 2) + 1 :], True)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_can_be_typed(page: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "satellite.glb").touch()  # what a reader has
    monkeypatch.chdir(tmp_path)
    for name in [name for name in os.environ if name.startswith("SKYPOSE_")]:
        monkeypatch.delenv(name)
    for command, whole in commands(page):
        program, *words = words_of(command)
        if program.removeprefix(".venv/bin/") == "skypose":
            is_skypose(words, whole)
        elif program == "python":
            is_python(words)
        elif program == "pytest":
            is_pytest(words)
        elif program.startswith("deploy/"):
            assert os.access(ROOT / program, os.X_OK), command
        elif (program, *words[:1]) == ("docker", "compose"):
            is_compose(words[1:])
        elif program == "kubectl" and "-k" in words:
            folder = ROOT / words[words.index("-k") + 1]
            assert (folder / "kustomization.yaml").exists(), command


def test_calls_that_are_shown_are_of_the_interface() -> None:
    known = json.loads((ROOT / "docs" / "openapi.json").read_text())["paths"]
    shapes = [re.compile(re.sub(r"\{\w+\}", r"[^/`?]+", path) + r"(\.\w+)?$") for path in known]
    for page in PAGES:
        for path in re.findall(r"`(?:GET|PUT|POST|DELETE|PATCH) (/v1/[^`?\s]*)", page.read_text()):
            assert any(shape.match(path) for shape in shapes), f"{page.name}: {path}"
