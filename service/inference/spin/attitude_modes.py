"""Which of the modes that operators use an attitude follows over a pass, by evidence (docs/motion.md)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from service.inference.pose import conjugate
from service.inference.spin.alignment import log_aligned_or_any, log_axis_along_z
from service.inference.spin.basins import MODES, AttitudeModes, Basin, PassMotion
from service.inference.spin.climb import MotionPrior, climb
from service.inference.spin.fit import TUMBLING, once, weighed
from service.inference.spin.frames import LOG_UNIFORM, PassFrames, seen_from
from service.inference.spin.rigid_body import Motions
from service.inference.spin.starts import anchors, distinct
from service.inference.state import Array

_HELD_RATE = 1e-7  # numerical: rad/s, as good as none
_ROUNDS, _TOPS = 20, 3  # numerical: steps of a climb, tops that are climbed


@dataclass(frozen=True)
class HeldPrior(MotionPrior):
    """Of a body that stands still in its reference frame; ``orientation``: log density per rad^3 of (B, 4)."""

    orientation: Callable[[Array], Array]

    def log_density(self, motions: Motions) -> Array:
        """(B,) with that of the rate, which the evidence integrates out again."""
        rate = -0.5 * np.sum((motions.rate / self.rate_sigma) ** 2, axis=1)
        rate -= 3 * (np.log(self.rate_sigma) + 0.5 * np.log(2 * np.pi))
        return np.asarray(self.orientation(motions.quaternion) + rate)


def attitude_modes(frames: PassFrames, references: Mapping[str, Array], found: PassMotion) -> AttitudeModes:
    """``frames``: of rotations body -> GCRF; ``found``: the motions that nothing holds.

    ``references``: (n, 4) rotations reference -> GCRF of every frame, of ``nadir_pointing`` (x along the orbit, y
    against its normal, z to the Earth's centre), ``yaw_steering`` (z to the Earth's centre, y across the Sun) and
    ``sun_pointing`` (z to the Sun).
    """
    laws = {
        "inertially_fixed": (None, _any),
        "nadir_pointing": (references["nadir_pointing"], log_aligned_or_any),
        "yaw_steering": (references["yaw_steering"], log_aligned_or_any),
        "sun_pointing": (references["sun_pointing"], log_axis_along_z),
    }
    tops = {name: _tops(frames, reference, law, found) for name, (reference, law) in laws.items()}
    lead = max((one for basins in tops.values() for one in basins), key=lambda one: one.log_evidence, default=None)
    free = [(one, 1 - TUMBLING if one.model == "constant_rate" else TUMBLING) for one in found.basins]
    first = max((one for one, _ in free), key=lambda one: one.log_evidence)
    lead = first if lead is None or first.log_evidence > lead.log_evidence else lead
    counted = lead.independent / (lead.explained * len(frames))
    logs = {name: _total([one.log_evidence + counted * one.log_weights for one in tops[name]]) for name in laws}
    for name, model in (("spin_stabilised", "constant_rate"), ("tumbling", "tumbling")):
        mine = [(one, share) for one, share in free if one.model == model]
        logs[name] = _total([one.log_evidence - np.log(share) + counted * one.log_weights for one, share in mine])
    total = _total(list(logs.values()))
    held = {name: max(basins, key=lambda one: one.log_evidence) for name, basins in tops.items() if basins}
    return AttitudeModes({name: float(np.exp(logs[name] - total)) for name in MODES}, held)


def _tops(frames: PassFrames, reference: Array | None, law: Callable[[Array], Array], found: PassMotion) -> list[Basin]:
    """Orientations against a reference that explain the frames."""
    seen = frames if reference is None else seen_from(frames, conjugate(reference))
    prior = HeldPrior(_HELD_RATE, np.zeros(5), 1.0, law)
    chosen = [seen.quaternion[k][np.isfinite(seen.log_weight[k])] for k in anchors(seen)]
    start = np.concatenate(chosen)
    motions = Motions(start, np.zeros((len(start), 3)), np.zeros((len(start), 0)))
    motions, score = climb(seen, motions, prior, found.reference_s, _ROUNDS)
    motions = motions[distinct(motions, score, frames.time_s - found.reference_s, _TOPS)]
    motions = motions[once(motions, found.rotations, found.half_span_s)]
    basins = [weighed(seen, motions[k : k + 1], prior, found.reference_s) for k in range(len(motions))]
    return [one for one in basins if one is not None]


def _any(quaternion: Array) -> Array:
    return np.full(len(quaternion), LOG_UNIFORM)


def _total(logs: list[float]) -> float:
    return float(np.logaddexp.reduce(logs)) if logs else -np.inf
