"""The error tree: as drawn, told apart by type, able to cross a process."""

import pickle
import re

import pytest

from service import errors
from service.api.problems import problem_document
from service.errors import ConfigError, MissingBlobError, every_error


def test_tree_is_as_drawn():
    drawn = dict(re.findall(r"(\w+Error)\s+(\d{3})", errors.__doc__))
    assert drawn == {kind.__name__: str(kind.status) for kind in every_error()}


def test_each_has_its_own_type():
    slugs = [kind.slug for kind in every_error()]
    assert len(set(slugs)) == len(slugs)


@pytest.mark.parametrize("kind", every_error())
def test_errors_cross_processes(kind):
    error = pickle.loads(pickle.dumps(kind("detail", field="body", limit=3)))
    assert (type(error), error.detail, error.field, error.facts) == (kind, "detail", "body", {"limit": 3})


def test_missing_blobs_are_named():
    error = pickle.loads(pickle.dumps(MissingBlobError.of(["b", "a"])))
    assert error.keys == ("a", "b")


def test_a_refusal_does_not_repeat_megabytes_of_what_was_sent():
    told = problem_document(ConfigError("no joint 'x" + "x" * 10**6, field="joints." + "y" * 10**6))
    assert len(told["detail"]) < 2100
    assert len(told["field"]) < 250
    assert told["detail"].startswith("no joint 'xx")
