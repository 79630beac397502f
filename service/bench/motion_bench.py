"""``skypose bench motion``: the motion of simulated passes, against the truth."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from rich.table import Table
from scipy.stats import chi2

from service.bench.motion_streams import StreamPlan, draw_stream, nutation_deg
from service.bench.tables import table_of
from service.inference.spin.basins import Basin, PassMotion, inertia_ratios, same_course, told
from service.inference.spin.fit import fit_pass
from service.inference.spin.rigid_body import Motions
from service.inference.state import Array

RATE_SIGMA = float(np.deg2rad(25.0))  # what a session believes of a rate by default
OBSERVED_SIGMA = 0.05  # stated, of an inertia ratio that counts as observable


@dataclass(frozen=True)
class MotionRow:
    """One pass."""

    law: str  # of the truth
    frames: int
    rate_deg_s: float
    sigma_deg: float | None  # of a frame; None: as the tracker has it
    stays: float | None
    lasts_s: float | None
    nutation_deg: float
    probability_of_law: float
    course_right: bool  # orientations within 6 degrees of the truth throughout
    rate_error_deg_s: float  # of the vector's length
    rate_error_share: float
    vector_error_deg_s: float
    axis_error_deg: float
    inside: float  # probability of the stated region that just reaches the truth's rate
    ratio_errors: tuple[float, ...]  # relative, of inertia ratios
    ratio_sigmas: tuple[float, ...]
    seconds: float


def score(found: PassMotion, truth: Motions, facts: dict[str, Any], seconds: float) -> MotionRow:
    """The answer of the truth's own law against it."""
    law = "tumbling" if truth.shape.shape[1] else "constant_rate"
    lead = found.best_of("tumbling" if truth.shape.shape[1] else "constant_rate")
    true = truth.rate[0]
    off, size = lead.motion.rate[0] - true, float(np.linalg.norm(true))
    length = float(np.linalg.norm(lead.motion.rate[0]))
    cosine = float(np.clip(lead.motion.rate[0] @ true / (length * size), -1, 1))
    spread = lead.covariance[3:6, 3:6]
    ratios = _ratios(lead, truth) if law == "tumbling" else ((), ())
    return MotionRow(
        law=law,
        rate_deg_s=float(np.rad2deg(size)),
        nutation_deg=nutation_deg(truth),
        probability_of_law=found.probability_of(lead.model),
        course_right=same_course(lead.motion, truth, found.half_span_s),
        rate_error_deg_s=float(np.rad2deg(abs(length - size))),
        rate_error_share=abs(length - size) / size,
        vector_error_deg_s=float(np.rad2deg(np.linalg.norm(off))),
        axis_error_deg=float(np.rad2deg(np.arccos(cosine))),
        inside=float(chi2.cdf(off @ np.linalg.solve(spread, off), 3)),
        ratio_errors=ratios[0],
        ratio_sigmas=ratios[1],
        seconds=seconds,
        **facts,
    )


def _ratios(lead: Basin, truth: Motions) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Relative errors of the inertia ratios, and their stated relative sigmas."""
    stated, true = told(lead, inertia_ratios), inertia_ratios(truth)
    return tuple((stated.value / true - 1).tolist()), tuple((stated.sigma / stated.value).tolist())


def run_streams(plan: StreamPlan, passes: int, seed: int, tell: Callable[[MotionRow], None]) -> list[MotionRow]:
    """``passes`` of each law."""
    rows = []
    for number in range(passes):
        for tumbling in (False, True):
            rng = np.random.default_rng([seed, number, int(tumbling)])
            one = draw_stream(rng, plan, tumbling=tumbling)
            began = time.perf_counter()
            found = fit_pass(one.frames, RATE_SIGMA)
            seconds = time.perf_counter() - began
            facts = {"sigma_deg": one.sigma_deg, "stays": one.stays, "lasts_s": one.lasts_s, "frames": plan.frames}
            rows.append(score(found, one.truth, facts, seconds))
            tell(rows[-1])
    return rows


def summary(rows: Sequence[MotionRow]) -> list[dict[str, Any]]:
    """A line per law of the truth."""
    found = []
    for law in dict.fromkeys(row.law for row in rows):
        mine = [row for row in rows if row.law == law]
        inside = _of(mine, "inside")
        seen = [
            abs(e)
            for row in mine
            for e, s in zip(row.ratio_errors, row.ratio_sigmas, strict=True)
            if s < OBSERVED_SIGMA
        ]
        met = [r.rate_error_share <= 0.005 or r.rate_error_deg_s <= 0.003 for r in mine]
        found.append(
            {
                "law": law,
                "passes": len(mine),
                "law_right": float(np.mean(_of(mine, "probability_of_law") > 0.5)),
                "course_right": float(np.mean(_of(mine, "course_right"))),
                "rate_med_deg_s": float(np.median(_of(mine, "rate_error_deg_s"))),
                "rate_med_share": float(np.median(_of(mine, "rate_error_share"))),
                "rate_met": float(np.mean(met)),
                "axis_med_deg": float(np.median(_of(mine, "axis_error_deg"))),
                "cover50": float(np.mean(inside <= 0.5)),
                "cover90": float(np.mean(inside <= 0.9)),
                "ratios_seen": len(seen),
                "ratios_within10": float(np.mean(np.array(seen) <= 0.1)) if seen else None,
                "seconds_med": float(np.median(_of(mine, "seconds"))),
            }
        )
    return found


def motion_document(machine: dict[str, Any], rows: Sequence[MotionRow]) -> dict[str, Any]:
    """The JSON."""
    return {"machine": machine, "rows": [asdict(row) for row in rows], "overall": summary(rows), "absent": {}}


def motion_table(document: dict[str, Any]) -> Table:
    """The lines of ``summary``."""
    return table_of("the motion of passes", document["overall"])


def _of(rows: Sequence[MotionRow], name: str) -> Array:
    return np.array([getattr(row, name) for row in rows], dtype=np.float64)
