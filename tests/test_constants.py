"""Every number that inference and imaging hold by name says what it is: nothing is tuned in secret."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PRIORS = ROOT / "service/inference/model/prior.py"
MODULES = sorted(p for part in ("inference", "imaging") for p in (ROOT / "service" / part).rglob("*.py") if p != PRIORS)
KINDS = ("prior", "numerical", "exact", "format", "contract", "shown")  # docs/architecture.md, Constants
SAYS = re.compile(rf"# ({'|'.join(KINDS)}): \S")
NUMBER = re.compile(r"\d+(?:\.\d+)?")


def numbers_in(tree: ast.AST) -> set[float]:
    """All that stand in it."""
    return {
        float(one.value) for one in ast.walk(tree) if isinstance(one, ast.Constant) and type(one.value) in (int, float)
    }


def held_numbers(source: str) -> Iterator[tuple[int, int, str]]:
    """First and last line, and names, of assignments of a module or class body that hold numbers."""
    for node in ast.parse(source).body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        counts = isinstance(node.value, ast.Call) and getattr(node.value.func, "id", "") == "range"  # an enumeration
        if numbers_in(node.value) and not counts:
            yield node.lineno, node.end_lineno or node.lineno, ast.unparse(getattr(node, "targets", [None])[0] or node)


def kind_told(lines: list[str], first: int, last: int) -> str | None:
    """By a comment of its own, or by one that heads the unbroken lines it stands in."""
    for line in lines[first - 1 : last]:
        if said := SAYS.search(line):
            return said[1]
    above = first - 2
    while above >= 0 and lines[above].strip():
        if said := SAYS.match(lines[above]):
            return said[1]
        above -= 1
    return None


def documents_of(path: Path) -> tuple[str, ...]:
    """Where the priors of a module are told."""
    if path.parent.name == "spin":
        return "motion.md", "objects.md"
    return ("method.md",) if path.name == "background.py" else ("model.md",)


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_number_says_whether_it_is_a_prior_or_numerical(path):
    source = path.read_text()
    lines = source.splitlines()
    hidden = [f"{first}: {name}" for first, last, name in held_numbers(source) if kind_told(lines, first, last) is None]
    assert hidden == []


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_prior_beside_its_code_is_told_in_a_document(path):
    source = path.read_text()
    lines = source.splitlines()
    told = {float(n) for name in documents_of(path) for n in NUMBER.findall((ROOT / "docs" / name).read_text())}
    for first, last, name in held_numbers(source):
        if kind_told(lines, first, last) == "prior":
            block = ast.parse("\n".join(line.strip() for line in lines[first - 1 : last]))
            assert not numbers_in(block) - told, name


def test_every_prior_has_a_reason_or_a_unit_and_stands_in_the_model():
    source, model = PRIORS.read_text(), (ROOT / "docs/model.md").read_text()
    lines = source.splitlines()
    for first, last, name in held_numbers(source):
        assert "#" in " ".join(lines[first - 1 : last]), name
    told = {float(number) for number in NUMBER.findall(model)}
    assigned = [node.value for node in ast.parse(source).body if isinstance(node, ast.Assign)]
    held = set[float]().union(*map(numbers_in, assigned))
    assert sorted(held - told) == []
