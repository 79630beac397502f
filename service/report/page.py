"""A report as one HTML file: no script, nothing that is loaded from elsewhere, fit to be printed."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from service.report.curves import absolute, charts, seconds_of
from service.report.film import Shot, film, stills
from service.report.sentences import attitude_sentence, turning_sentence
from service.report.templating import template

Document = Mapping[str, Any]
_MOST_STILLS = 6
_MOST_POINTS = 1000  # of a curve: it is 660 px wide


@dataclass(frozen=True)
class Facts:
    """All that a report tells, as the API tells it."""

    session: Document
    models: Sequence[Document]
    estimates: Sequence[Document]  # at least one; with all later frames taken into account
    motion: Document | None
    why_no_motion: str  # where there is none
    shots: Sequence[Shot]  # in the order of their frames
    why_no_pictures: str  # where pictures are missing
    span_px: float  # side of the square that a picture shows
    system: Document  # versions and devices
    made_at: str


def report_html(facts: Facts) -> bytes:
    """The file."""
    chosen = [facts.shots[k] for k in evenly(len(facts.shots), _MOST_STILLS)]
    estimates = facts.estimates
    page = template("report.html").render(
        facts=facts,
        session=facts.session,
        motion=facts.motion,
        sentences=(turning_sentence(facts.motion, facts.why_no_motion), attitude_sentence(facts.motion, estimates)),
        seconds=seconds_of(estimates),
        absolute=absolute(estimates),
        statuses=Counter(estimate["status"] for estimate in estimates),
        film=film(facts.shots, facts.span_px),
        stills=stills(chosen, facts.span_px),
        charts=charts([estimates[k] for k in evenly(len(estimates), _MOST_POINTS)]),
        places=[estimates[k] for k in evenly(len(estimates), 5)],
        warnings=_said(facts),
        settings=json.dumps(_settings(facts.session), indent=1, ensure_ascii=False),
    )
    return page.encode()


def evenly(count: int, most: int) -> list[int]:
    """Numbers of so many things spread evenly over ``count`` of them, the first and the last among them."""
    if count <= most:
        return list(range(count))
    return [round(k * (count - 1) / (most - 1)) for k in range(most)]


def counted(texts: Iterable[str]) -> list[str]:
    """Of texts that differ in numbers only the first, with how many there were of its kind."""
    kinds: dict[str, list[str]] = {}
    for text in texts:
        kinds.setdefault(re.sub(r"\d+(\.\d+)?", "0", text), []).append(text)
    return [f"{alike[0]} ({len(alike)} frames)" if len(alike) > 1 else alike[0] for alike in kinds.values()]


def _said(facts: Facts) -> list[str]:
    """Warnings of all frames, each kind once, with how many it came with."""
    out = [*facts.session["warnings"], *(facts.motion["warnings"] if facts.motion else ())]
    out += counted(text for estimate in facts.estimates for text in estimate["warnings"])
    assumed = Counter(text for estimate in facts.estimates for text in estimate["assumed"])
    names = {
        "background": "the sky was learnt from around the object",
        "time": "frames brought no time of their own",
        "attitude_mode": "the body is held as the session was told",
    }
    out += [f"assumed: {names.get(name, name)} ({count} frames)" for name, count in assumed.items()]
    return list(dict.fromkeys(out))


def _settings(session: Document) -> Document:
    sections = ("filter", "likelihood", "prior", "motion", "camera", "joints", "light", "background")
    return {name: session[name] for name in sections}
