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


def holding(source: str) -> Iterator[ast.Assign | ast.AnnAssign]:
    """Assignments of a module body that hold numbers."""
    for node in ast.parse(source).body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        counts = isinstance(node.value, ast.Call) and getattr(node.value.func, "id", "") == "range"  # an enumeration
        if numbers_in(node.value) and not counts:
            yield node


def held_numbers(source: str) -> Iterator[tuple[int, int, str]]:
    """First and last line, and names, of each."""
    for node in holding(source):
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


def named(path: Path, kind: str | None) -> Iterator[str]:
    """What section 8 of the model says of each: names, then their values."""
    source = path.read_text()
    for node in holding(source):
        if kind is None or kind_told(source.splitlines(), node.lineno, node.end_lineno or node.lineno) == kind:
            target = node.target if isinstance(node, ast.AnnAssign) else node.targets[0]
            names = ", ".join(f"`{name}`" for name in re.findall(r"\w+", ast.unparse(target)))
            values = re.findall(r"\d[\d.]*(?: / \d[\d.]*)?", ast.unparse(node.value or node))
            yield f"{names} {', '.join(re.sub(r'[.]0$', '', one).replace(' ', '') for one in values)}"


@pytest.mark.parametrize("path", [PRIORS, *MODULES], ids=lambda path: str(path.relative_to(ROOT)))
def test_every_prior_of_the_model_stands_in_it_by_name(path):
    if documents_of(path) != ("model.md",):
        pytest.skip("its priors are told in another document")
    _, section = (ROOT / "docs/model.md").read_text().split("## 8. Priors by name")
    told = [" ".join(item.split()) for item in section.split("\n- ")]
    of_file = [item for item in told if path.name in item] if path != PRIORS else told
    missing = [one for one in named(path, None if path == PRIORS else "prior") if not any(one in i for i in of_file)]
    assert missing == []


def unnamed_numbers(source: str) -> Iterator[str]:
    """Lines of functions with a number that is neither named nor said what it is.

    Whole numbers count, halves to eighths are arithmetic, and what is a thousandth at the most guards a division.
    ``require`` tells a caller the ends of what it may ask for.
    """
    lines, tree = source.splitlines(), ast.parse(source)
    required = [one for one in ast.walk(tree) if isinstance(one, ast.Call) and getattr(one.func, "id", "") == "require"]
    told = {id(number) for call in required for number in ast.walk(call)}
    functions = [one for one in ast.walk(tree) if isinstance(one, ast.FunctionDef)]
    numbers = {id(one): one for function in functions for one in ast.walk(function) if isinstance(one, ast.Constant)}
    for one in numbers.values():
        tuned = type(one.value) is float and one.value > 1e-3 and (8 * one.value) % 1 and id(one) not in told
        if tuned and not any(SAYS.search(near) for near in lines[one.lineno - 2 : one.lineno]):
            yield f"{one.lineno}: {one.value}"


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_function_hides_a_number(path):
    assert list(unnamed_numbers(path.read_text())) == []


def test_a_hidden_number_would_be_found():
    assert list(unnamed_numbers("def f(x):\n    return 0.7 * x + 0.5\n")) == ["2: 0.7"]
    assert list(unnamed_numbers("def f(x):\n    return 0.7 * x  # exact: seven tenths\n")) == []
