"""One object over two sites, drawn, tracked by two sessions, put together: against either alone.

    python tests/e2e/two_sites.py --passes 4 [--frames 20] [--seed 0] [--mesh FILE] [--json FILE]

Real orbit, real Sun, another air for each telescope. Prints the errors of orientation and rate at the middle of each
pass: of the first telescope, of the second, of both together.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from service.attitude.camera import Site
from service.cli.model_file import read_model_file
from service.cli.own_service import own_service
from service.cli.simulate import random_scenario
from service.client import Client, RefusedError
from service.inference.pose import angle_between, exp_so3, multiply
from service.simulate.folder import describe, encode_png, true_attitude
from service.simulate.overflight import Overflight, utc_text
from service.simulate.sequence import SimulatedPass

TLE = """1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991
2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482"""
SITES = (Site(48.23, 16.34, 250.0), Site(48.0, 12.3, 500.0))  # 300 km apart
START = datetime(2019, 12, 11, 15, 5, tzinfo=UTC)


@dataclass(frozen=True)
class Errors:
    """Of one answer, at its own middle."""

    orientation_deg: float
    rate_deg_s: float
    stated_deg: float


def simulated(model, seed: int, frames: int) -> list[SimulatedPass]:
    """What each of the sites sees."""
    base = random_scenario("mixed", seed, None, frames)
    motion = replace(base.motion, frame_interval_s=0.5, joints=(), rate_deg_s=min(base.motion.rate_deg_s, 3.0))
    base = replace(base, motion=motion)
    overs = [Overflight(site, TLE, START, 0.0, SITES[0]) for site in SITES]
    return [
        SimulatedPass(model.mesh, model.articulation, replace(base, overflight=over, telescope=n))
        for n, over in enumerate(overs)
    ]


def tracked(client: Client, model_id: str, one: SimulatedPass) -> str:
    """A session over one site's frames."""
    told, over = describe(one, "pass", "mesh"), one.scenario.overflight
    site = {f"site_{name}": value for name, value in told["site"].items()}
    config = {"camera": {**told["camera"], **site}, "prior": {"orbit": over.elements, "unit_m": told["unit_m"]}}
    session = client.create_session(model_id, **config).session_id
    for image in one.backgrounds():
        client.add_background(session, encode_png(image), "image/png")
    for look, image in zip(one.looks, one.frames(), strict=True):
        facts = {"time": utc_text(look.moment), "ra_deg": look.ra_deg, "dec_deg": look.dec_deg}
        client.post_frame(session, encode_png(image), "image/png", **facts, position_angle_deg=0.0)
    return session


def errors_of(one: SimulatedPass, motion) -> Errors:
    """An answer against the truth, which turns at a constant rate about its own axes."""
    first = true_attitude(one, 0)
    times = one.track.time_s
    last = true_attitude(one, len(times) - 1)
    interval = times[1] - times[0]
    turn = multiply(first * [1, -1, -1, -1], true_attitude(one, 1))
    rate = 2 * np.arctan2(np.linalg.norm(turn[1:]), turn[0]) * turn[1:] / np.linalg.norm(turn[1:]) / interval
    assert np.rad2deg(angle_between(multiply(first, exp_so3(rate * times[-1])), last)) < 1.0
    seconds = (datetime.fromisoformat(motion.epoch) - one.looks[0].moment).total_seconds()
    truth = multiply(first, exp_so3(rate * seconds))
    q, w = motion.orientation, motion.angular_velocity_body_deg_s
    off = float(np.rad2deg(angle_between(np.array([q.w, q.x, q.y, q.z]), truth)))
    return Errors(
        off, float(np.linalg.norm(np.array([w.x, w.y, w.z]) - np.rad2deg(rate))), motion.orientation_sigma_deg
    )


def main() -> None:
    """Passes in turn, a line each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--passes", type=int, default=4)
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--mesh", default="demo")
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args()
    model, rows = read_model_file(chosen.mesh), []
    for k in range(chosen.passes):
        sites = simulated(model, chosen.seed + k, chosen.frames)
        with own_service() as client:
            model_id = client.upload_model(model.data, file_name=model.name).model_id
            sessions = [tracked(client, model_id, one) for one in sites]
            together = client.create_object("both", sessions).object_id
            row, answers = {}, {"first": sessions[0], "second": sessions[1], "both": None}
            for name, session in answers.items():
                try:
                    told = client.object_motion(together) if session is None else client.motion(session)
                    row[name] = errors_of(sites[0], told)
                except RefusedError as error:
                    print(f"{name}: {error.detail}")
            statuses = [client.estimate(session).status for session in sessions]
        rows.append({"note": sites[0].scenario.note, **{name: vars(one) for name, one in row.items()}})
        said = ", ".join(
            f"{name} {one.orientation_deg:.2f} (±{one.stated_deg:.2f}) deg, {one.rate_deg_s:.3f} deg/s"
            for name, one in row.items()
        )
        print(f"{sites[0].scenario.note}; {statuses}: {said}", flush=True)
    if chosen.json:
        chosen.json.write_text(json.dumps(rows))


if __name__ == "__main__":
    main()
