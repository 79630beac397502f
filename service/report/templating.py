"""The HTML templates of reports."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from service.report.sentences import told_probability, with_sigma

if TYPE_CHECKING:
    from jinja2 import Template


@cache
def template(name: str) -> Template:
    """One of ``templates/``."""
    from jinja2 import Environment, PackageLoader, StrictUndefined  # not at the start: few ask for a report

    found = Environment(
        loader=PackageLoader("service.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    found.filters["sigma"] = with_sigma
    found.filters["probability"] = told_probability
    return found.get_template(name)
