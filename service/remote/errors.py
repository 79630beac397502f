"""What a client raises.

    ClientError
     +-- RefusedError         the service answered with a problem document (RFC 9457)
     +-- UnexpectedError      an answer that is not the service's: a proxy's page, a broken line

Connections that fail for good raise what httpx raised: ``httpx.TransportError``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import httpx

_PREFIX = "urn:skypose:problem:"


class ClientError(Exception):
    """Base of the clients' own errors."""


class UnexpectedError(ClientError):
    """An answer that does not have the service's form."""


class RefusedError(ClientError):
    """The service refused a call; nothing was changed by it. docs/errors.md lists the kinds."""

    def __init__(self, problem: Mapping[str, Any]) -> None:
        self.problem = dict(problem)
        """The whole document, with the members that help to mend the call."""
        self.status = int(problem.get("status", 500))
        self.kind = str(problem.get("type", "")).removeprefix(_PREFIX)
        """Its type without the prefix, such as ``frame-gap``."""
        self.detail = str(problem.get("detail") or problem.get("title") or "")
        field = problem.get("field")
        self.field = None if field is None else str(field)
        super().__init__(f"{self.status} {self.kind}: {self.detail}")


def is_problem(document: Any) -> bool:
    """Whether a JSON document is one of the service's problems."""
    return isinstance(document, Mapping) and str(document.get("type", "")).startswith(_PREFIX)


def refusal(response: httpx.Response) -> ClientError:
    """The error for an answer of status 400 or more whose body was read."""
    try:
        document = response.json()
    except ValueError:
        document = None
    if is_problem(document):
        return RefusedError(document)
    return UnexpectedError(f"{response.status_code} from {response.url}, without a problem document")
