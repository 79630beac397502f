"""The HTML templates of reports."""

from __future__ import annotations

from functools import cache

from jinja2 import Environment, PackageLoader, StrictUndefined, Template

from service.report.sentences import told_probability, with_sigma


@cache
def template(name: str) -> Template:
    """One of ``templates/``."""
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
