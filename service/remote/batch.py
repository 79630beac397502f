"""The answer to a file of several frames: newline-delimited JSON, one estimate per line."""

from __future__ import annotations

import orjson

from service.api.schemas import Estimate
from service.remote.calls import parsed
from service.remote.errors import RefusedError, UnexpectedError, is_problem


class BatchLines:
    """Lines to estimates. Where the file is sent again, what was told already is passed over."""

    def __init__(self) -> None:
        self._told = 0
        self._seen = 0

    def restart(self) -> None:
        """The next line is the first of a new answer."""
        self._seen = 0

    def take(self, line: str) -> Estimate | None:
        """The estimate of a line, None for one that was told before. Raises ``ClientError``."""
        try:
            document = orjson.loads(line)
        except orjson.JSONDecodeError as error:
            raise UnexpectedError(f"a line of the answer is no JSON: {error}") from error
        if is_problem(document):
            raise RefusedError(document)
        self._seen += 1
        if self._seen <= self._told:
            return None
        self._told += 1
        return parsed(Estimate, document)
