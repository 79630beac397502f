"""Structured logs on stderr: one JSON object a line, or text for people."""

from __future__ import annotations

import logging
import re
import sys
from typing import Any

import structlog

_SECRET = re.compile(r"((?:[?&]|\b)ticket=|\bBearer )[^\s&\"'\\]+", re.IGNORECASE)


def without_secrets(logger: object, name: str, line: str) -> str:
    """A finished line without tickets and keys: uvicorn writes the addresses of WebSockets, with their queries."""
    return _SECRET.sub(r"\1...", line)


def configure(level: str, log_format: str) -> None:
    """Set up structlog and pass the standard library's records (uvicorn, alembic) through the same form.

    ``log_format``: ``json``, ``text``, or ``auto``: text on a terminal, else JSON.
    """
    shared: list[Any] = [
        structlog.contextvars.merge_contextvars,
        structlog.stdlib.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
        structlog.processors.StackInfoRenderer(),
    ]
    if log_format == "json" or (log_format == "auto" and not sys.stderr.isatty()):
        # Without the values of local variables: a key or a frame may be among them.
        plain = structlog.processors.ExceptionRenderer(structlog.tracebacks.ExceptionDictTransformer(show_locals=False))
        last: list[Any] = [plain, structlog.processors.JSONRenderer(), without_secrets]
    else:
        last = [
            structlog.dev.ConsoleRenderer(
                colors=sys.stderr.isatty(), exception_formatter=structlog.dev.plain_traceback
            ),
            without_secrets,
        ]
    structlog.configure(
        processors=[*shared, structlog.stdlib.ProcessorFormatter.wrap_for_formatter],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.make_filtering_bound_logger(logging.getLevelName(level.upper())),
        cache_logger_on_first_use=True,
    )
    formatter = structlog.stdlib.ProcessorFormatter(
        foreign_pre_chain=shared, processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, *last]
    )
    handler = logging.StreamHandler()
    handler.setFormatter(formatter)
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(level.upper())
    logging.getLogger("alembic").setLevel("WARNING")
    logging.getLogger("uvicorn.access").disabled = True  # service.api.observe writes one line per call
