"""What a reader meets: short lines, links that lead somewhere, files and names that are there."""

import pkgutil
import re
from dataclasses import fields
from pathlib import Path

import pytest
import yaml

import service
from service.inference.params import SessionConfig

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
ROOMS = ("", "service", "service/inference", "service/inference/model", "docs", "docs/examples", "tests", "deploy")
DATE = r"\b20\d\d-\d\d-\d\d\b"
MOST_COLUMNS, MOST_README_LINES = 120, 120


def prose(text: str) -> str:
    """Without fenced blocks."""
    return re.sub(r"^```.*?^```$", "", text, flags=re.M | re.S)


def anchors(page: Path) -> set[str]:
    """Of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", prose(page.read_text()), flags=re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) <= MOST_README_LINES


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_lines_are_short(page: Path) -> None:
    """A table whose rows would be longer is a list, or several tables."""
    assert [line for line in page.read_text().splitlines() if len(line) > MOST_COLUMNS] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(page.read_text())):
        if "://" in target:
            continue
        path, _, anchor = target.partition("#")
        there = (page.parent / path).resolve() if path else page
        assert there.exists(), target
        assert not anchor or anchor in anchors(there), target


@pytest.mark.parametrize("page", PAGES[:1] + PAGES[2:], ids=lambda page: str(page.relative_to(ROOT)))
def test_files_that_are_named_are_there(page: Path) -> None:
    for name in re.findall(r"`(\w[\w/.-]*/[\w.-]+\.(?:py|cl|js|yaml|md|json))`", page.read_text()):
        assert any((ROOT / room / name).exists() for room in ROOMS), name


CODE = ("", "service.", "service.inference.")  # before a name, as pages shorten it
HEADS = {
    "service",
    "gpu",
    *(
        found.name
        for path in (*service.__path__, f"{service.__path__[0]}/inference")
        for found in pkgutil.iter_modules([path])
    ),
}
FILES = (".py", ".json", ".js", ".aem", ".png", ".html", ".md", ".txt")
SECTIONS = {
    f"{section.name}.{field.name}"
    for section in fields(SessionConfig)
    for field in fields(getattr(SessionConfig(), section.name))
}


def is_there(name: str) -> bool:
    """Whether a dotted name is a module of ours, something in one, or a field of a session's configuration."""
    for prefix in CODE:
        try:
            pkgutil.resolve_name(prefix + name)
        except (ImportError, AttributeError):
            continue
        return True
    return name in SECTIONS


@pytest.mark.parametrize("page", PAGES[:1] + PAGES[2:], ids=lambda page: str(page.relative_to(ROOT)))
def test_names_of_the_code_resolve(page: Path) -> None:
    dotted = re.findall(r"`([a-z]\w*(?:\.\w+)+)(?:\([^`]*\))?`", prose(page.read_text()))
    ours = [name for name in dotted if name.split(".")[0] in HEADS and not name.endswith(FILES)]
    assert [name for name in ours if not is_there(name)] == []


def test_the_citation_is_of_this_release() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert f'version = "{cited["version"]}"' in (ROOT / "pyproject.toml").read_text()
    assert {"cff-version", "message", "title", "authors"} <= set(cited)


def test_figures_have_a_date() -> None:
    """A section of the benchmarks with a table of figures says when they were measured; so do other measurements."""
    text = prose((ROOT / "docs" / "benchmarks.md").read_text())
    sections = re.split(r"^##+ ", text, flags=re.M)[1:]
    figures = [one for one in sections if len(re.findall(r"^\|.*\| *[\d.,]+ *\|", one, flags=re.M)) > 2]
    assert len(figures) > 8
    for name in ("scale", "trust", "cluster", "engines"):
        assert re.search(DATE, (ROOT / "docs" / f"{name}.md").read_text()), name
    assert [one.splitlines()[0] for one in figures if not re.search(DATE, one)] == []
