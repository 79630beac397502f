"""``skypose bench motion --stations``: one body, seen by two telescopes; its motion by each alone and by both."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from rich.table import Table

from service.bench.motion_bench import RATE_SIGMA
from service.bench.motion_streams import StreamPlan, draw_motion, drawn_quality, seen_stream
from service.bench.tables import table_of
from service.inference.pose import angle_between, conjugate, exp_so3, multiply
from service.inference.spin.basins import PassMotion, same_course
from service.inference.spin.fit import fit_pass
from service.inference.spin.frames import merged, seen_from
from service.inference.spin.rigid_body import Motions, orientations

_RANGE_KM = 700.0  # of the object: the angle between two lines of sight is that of the base by it
_ALONE = ("first", "second")


@dataclass(frozen=True)
class StationRow:
    """One pass; of ``first``, ``second`` and ``both``."""

    rate_deg_s: float
    apart_deg: float  # between the lines of sight
    error_deg: dict[str, float]  # of the orientation at the middle
    sigma_deg: dict[str, float]  # as stated
    course_right: dict[str, bool]
    probability: dict[str, float]  # of the course that is told


def run_stations(
    plan: StreamPlan, passes: int, base_km: float, seed: int, tell: Callable[[StationRow], None]
) -> list[StationRow]:
    """Bodies at a constant rate; the second telescope stands ``base_km`` across the line of sight."""
    rows = []
    for number in range(passes):
        rows.append(_row(np.random.default_rng([seed, number]), plan, float(np.arctan(base_km / _RANGE_KM))))
        tell(rows[-1])
    return rows


def _row(rng: np.random.Generator, plan: StreamPlan, apart: float) -> StationRow:
    times = np.linspace(0.0, plan.span_s, plan.frames)
    truth = draw_motion(rng, plan, tumbling=False)
    q = orientations(truth, times - plan.span_s / 2)[0]
    side = rng.uniform(0, 2 * np.pi)
    across = np.array([np.cos(side), np.sin(side), 0.0])  # of the first one's line of sight, which is z
    cameras = np.array([[1.0, 0.0, 0.0, 0.0], exp_so3(apart * across)])
    quality = drawn_quality(rng)  # telescopes and air are alike; how errors stay is each one's own
    seen = [seen_stream(rng, times, multiply(conjugate(camera), q), quality).frames for camera in cameras]
    stations = [seen_from(one, np.tile(camera, (len(times), 1))) for one, camera in zip(seen, cameras, strict=True)]
    found = {name: fit_pass(one, RATE_SIGMA) for name, one in zip(_ALONE, stations, strict=True)}
    found["both"] = fit_pass(merged(stations)[0], RATE_SIGMA)
    return StationRow(
        rate_deg_s=float(np.rad2deg(np.linalg.norm(truth.rate))),
        apart_deg=float(np.rad2deg(apart)),
        error_deg={name: _error_deg(one, truth) for name, one in found.items()},
        sigma_deg={
            name: float(np.rad2deg(np.sqrt(np.trace(one.basins[0].covariance[:3, :3])))) for name, one in found.items()
        },
        course_right={name: _is_right(one, truth) for name, one in found.items()},
        probability={name: one.courses()[0][0] for name, one in found.items()},
    )


def _error_deg(found: PassMotion, truth: Motions) -> float:
    return float(np.rad2deg(angle_between(found.basins[0].motion.quaternion, truth.quaternion)[0]))


def _is_right(found: PassMotion, truth: Motions) -> bool:
    return same_course(found.courses()[0][1].motion, truth, found.half_span_s)


def _better(row: StationRow) -> str:
    return min(_ALONE, key=row.sigma_deg.__getitem__)


def summary(rows: Sequence[StationRow]) -> dict[str, Any]:
    """Of the better one alone, by what it states, and of both; errors where their courses are right.

    ``ideal_ratio``: of two that err independently, as they state; 1/sqrt(2) where they are equally good.
    """
    better = [_better(row) for row in rows]
    pairs = list(zip(rows, better, strict=True))
    right = [(row, name) for row, name in pairs if row.course_right[name] and row.course_right["both"]]
    errors = np.array([(row.error_deg[name], row.error_deg["both"]) for row, name in right])
    stated = np.array([[row.sigma_deg[name] for name in _ALONE] for row, _ in right]) ** -2.0
    return {
        "passes": len(rows),
        "right_better": float(np.mean([row.course_right[name] for row, name in pairs])),
        "right_both": float(np.mean([row.course_right["both"] for row in rows])),
        "sure_both": float(np.mean([row.probability["both"] for row in rows])),
        "rms_better_deg": float(np.sqrt(np.mean(errors[:, 0] ** 2))),
        "rms_both_deg": float(np.sqrt(np.mean(errors[:, 1] ** 2))),
        "ratio": float(np.sqrt(np.mean(errors[:, 1] ** 2) / np.mean(errors[:, 0] ** 2))),
        "ideal_ratio": float(np.sqrt(np.sum(1 / stated.sum(axis=1)) / np.sum(1 / stated.max(axis=1)))),
        "median_ratio": float(np.median(errors[:, 1]) / np.median(errors[:, 0])),
    }


def station_document(machine: dict[str, Any], rows: Sequence[StationRow]) -> dict[str, Any]:
    """The JSON."""
    return {"machine": machine, "rows": [asdict(row) for row in rows], "overall": summary(rows), "absent": {}}


def station_table(document: dict[str, Any]) -> Table:
    """The line of ``summary``."""
    return table_of("one body, two telescopes", [document["overall"]])
