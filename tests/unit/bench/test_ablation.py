"""A part that is left out is left out everywhere."""

import ast
from pathlib import Path

import pytest

from service.bench.ablation import VARIANTS, altered
from service.inference.model import prior

ALTERED = sorted({name for variant in VARIANTS for name in variant.priors})
MODULES = [path for top in ("service", "gpu") for path in Path(top).rglob("*.py") if path.name != "prior.py"]


def taken_once(tree: ast.Module) -> set[str]:
    """Names of altered priors that a module copies when it is imported."""
    inner = [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)]
    later = {
        id(n) for f in inner for part in (f.body if isinstance(f.body, list) else [f.body]) for n in ast.walk(part)
    }
    copied = {alias.name for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) for alias in n.names}
    read = {n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute) and id(n) not in later}
    return (copied | read) & set(ALTERED)


def test_an_altered_prior_is_read_where_it_is_used():
    """A module that copies a prior goes on with its old value, and the table shows that the part is for nothing."""
    assert {str(path): names for path in MODULES if (names := taken_once(ast.parse(path.read_text())))} == {}


@pytest.mark.parametrize("source", ["from a.prior import BIRTH", "X = 1 / prior.BIRTH", "def f(x=prior.BIRTH): pass"])
def test_copies_are_found(source):
    assert taken_once(ast.parse(source)) == {"BIRTH"}


def test_a_function_may_read_them():
    assert taken_once(ast.parse("def f():\n    return prior.BIRTH\nG = lambda: prior.BIRTH")) == set()


def test_priors_are_as_they_were_afterwards():
    before = prior.BIRTH
    with altered({"BIRTH": 0.5}):
        assert prior.BIRTH == 0.5
    assert before == prior.BIRTH
