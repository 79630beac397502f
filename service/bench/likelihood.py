"""``skypose bench likelihood``: does the light of single frames prefer the truth to all else that a search meets."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from itertools import islice
from statistics import median

import numpy as np
from numpy.typing import NDArray

from service.bench.cases import Case, TruthFrame
from service.bench.likelihood_basins import (
    NEAR_DEG,
    REGION_50,
    REGION_90,
    Likeness,
    margin,
    squared_deviation,
    twin_margin,
)
from service.bench.runner import learned_sky
from service.bench.told import Told, turned
from service.imaging.background import Background
from service.imaging.decode import decode_frame
from service.imaging.sky import Sky, derive
from service.inference.articulation import Articulation, hold
from service.inference.model.drawing import Quality, View
from service.inference.model.search import Found, make_bank, search
from service.inference.model.stages import Body
from service.inference.model.templates import Bank
from service.inference.numerics.gauss_newton import ascend
from service.inference.numerics.hill import Hill, Refined
from service.inference.numerics.priors import PosePrior
from service.inference.pose import angle_between, concatenate, retract
from service.inference.state import Array, Poses
from service.sessions.config import effective
from service.workers.lit_body import LitBody
from service.workers.lit_frame import LightOfFrame
from service.workers.tracker import Tracker

_PNG = "image/png"
_PSF_PX = 1.2  # where a frame shows too few edges to tell
_ASIDE = np.array([0.6, 0.0, -0.8])  # towards a Sun of which nothing is known
_ANY_SUN = 1.0  # rad: what a session is told that is told no Sun
_CLIMB = 4  # steps of the truth and of its twins
_OFF_STEPS = 6
_OFF_DEG, _OFF_PX, _OFF_SCALE, _OFF_SHARE = 2.0, 1.0, 0.01, 0.01  # of pose, place, scale, of a sliding joint's range
_REPEATS, _ROUGH_POSES = 5, 33
_DRAWN, _DRAWN_SIDE, _DRAWN_QUALITY = 64, 64, Quality(supersample=3, shadow_px=256)
_DRAWN_SPREAD = 0.02  # rad between the poses that are drawn


@dataclass(frozen=True)
class LikelihoodPlan:
    """What is told of a pass, and at which of its frames is looked."""

    told: Told = field(default_factory=Told)
    sun_sigma_deg: float = 1.0
    frames: tuple[int, ...] = (0, 5, 10)
    limit: int | None = None  # frames of each pass

    @property
    def wanted(self) -> list[int]:
        """The frames that are looked at, in order."""
        return sorted({k for k in self.frames if self.limit is None or k < self.limit})

    @property
    def says(self) -> str:
        """What is told, in words."""
        off = f" {self.told.sun_off_deg:g}° wrong" if self.told.sun_off_deg else ""
        sun = f"the Sun{off} (to {self.sun_sigma_deg:g}°)" if self.told.sun else "no Sun"
        return f"told: {sun}, {'the scale by its range' if self.told.scale else 'no scale'}"

    def prior(self, case: Case) -> PosePrior:
        """The same as a prior of this pass's poses. A pass that does not know its Sun or scale tells nothing of it."""
        prior = PosePrior(sun_sigma=_ANY_SUN)
        if self.told.sun and case.towards_sun is not None:
            sun = turned(case.towards_sun, self.told.sun_off_deg)
            prior = replace(prior, towards_sun=sun, sun_sigma=float(np.deg2rad(self.sun_sigma_deg)))
        if self.told.scale and case.scale_prior is not None:
            scale, sigma = case.scale_prior
            prior = replace(prior, log_scale=float(np.log(scale)), log_scale_sigma=sigma)
        return prior


@dataclass(frozen=True)
class LikelihoodRow:
    """One frame. None: not defined there (``likelihood_basins``)."""

    case: str
    frame: int
    turbulent: bool
    truth_wins: bool
    margin_nats: float | None
    twin_margin_nats: float | None
    found_err_deg: float | None  # None: nothing was found
    found_twin_ok: bool | None
    refined_err_deg: float
    in50: bool
    in90: bool
    rough_nats: float  # of the evidence between neighbouring poses, finely
    bank_ms: float  # once a pass
    search_ms: float
    evidence_ms: float  # of one pose, finely
    draw_us: float  # of one of many


@dataclass(frozen=True)
class Views:
    """What the model makes of a frame, (S, S) each: at the truth, and at the best basin that is not the truth's."""

    frame: NDArray[np.float32]  # after its low pass
    truth: tuple[NDArray[np.float32], NDArray[np.float32]]  # model, residual
    other: tuple[NDArray[np.float32], NDArray[np.float32]] | None


@dataclass(frozen=True)
class Looked:
    """One frame's figures, and its pictures."""

    row: LikelihoodRow
    views: Views


@dataclass(frozen=True)
class _Pass:
    """What all frames of a pass share."""

    case: Case
    held: Articulation
    sky: Sky
    body: Body
    bank: Bank
    bank_ms: float
    told: PosePrior


def bench_case(
    tracker: Tracker, case: Case, plan: LikelihoodPlan, say: Callable[[int], None], absent: dict[str, str]
) -> Iterator[Looked]:
    """The frames of a pass one by one; ``say`` hears which. What cannot be looked at comes to ``absent``, with why.

    Raises ``DeviceError`` where no CPU is an OpenCL device.
    """
    held, told, wanted = hold(case.model.articulation, case.free, {}), plan.prior(case), plan.wanted
    config = effective({})
    sky = Background.from_bytes(learned_sky(tracker, case, config, list(case.backgrounds())))
    likelihood = config.likelihood
    with closing(LitBody(case.model.mesh, held)) as lit:
        began = time.perf_counter()
        bank = make_bank(lit.body, told)
        shared = _Pass(
            case,
            held,
            derive(sky, likelihood.feature, likelihood.gradient_sigma_px),
            lit.body,
            bank,
            1e3 * (time.perf_counter() - began),
            told,
        )
        for k, (data, truth) in enumerate(islice(case.frames(), max(wanted, default=-1) + 1)):
            if k in wanted:
                say(k)
                looked = _look(shared, k, data, truth) if truth.visible else None
                if looked is None:
                    absent[f"{case.name} {k}"] = "no light is found" if truth.visible else "the frame is empty"
                else:
                    yield looked


def _look(shared: _Pass, k: int, data: bytes, truth_frame: TruthFrame) -> Looked | None:
    """None: no light is found."""
    frame = decode_frame(data, _PNG)
    began = time.perf_counter()
    light = LightOfFrame(frame.image, shared.sky, frame.bits, None)
    if light.sight is None:
        return None
    found = search(shared.body, light.sight, shared.bank, shared.told, light.wide)
    search_ms = 1e3 * (time.perf_counter() - began)
    pose = truth_frame.poses(shared.held)
    likeness = Likeness.of(shared.case, shared.held, pose)
    sun = _sun(shared, found)
    truth, *twins = _climbed(found.hill, pose if likeness.twins is None else concatenate(pose, likeness.twins), sun)
    away = retract(pose, off(shared.held, np.random.default_rng([k, *shared.case.name.encode()])))
    back = ascend(found.hill, away, sun[None].copy(), steps=_OFF_STEPS)[0]
    best = found.basins[0].pose if found.basins else None
    errors, values = _errors(likeness, found.basins), _values(found.basins)
    beaten = margin(truth.log_posterior, values, errors)
    deviation = squared_deviation(back.pose, back.covariance, pose)
    row = LikelihoodRow(
        case=shared.case.name,
        frame=k,
        turbulent=shared.case.facts.get("d_over_r0", 0.0) > 0,
        truth_wins=beaten is None or beaten >= 0,
        margin_nats=beaten,
        twin_margin_nats=_twin_margin(truth, twins, likeness),
        found_err_deg=None if best is None else float(errors[0]),
        found_twin_ok=None if best is None else likeness.right_twin(best),
        refined_err_deg=float(np.rad2deg(angle_between(back.pose.quaternion, pose.quaternion))[0]),
        in50=deviation < REGION_50,
        in90=deviation < REGION_90,
        rough_nats=_rough_nats(found.hill, back),
        bank_ms=shared.bank_ms,
        search_ms=search_ms,
        evidence_ms=_evidence_ms(found.hill, truth),
        draw_us=_draw_us(found.hill, truth),
    )
    other = None if beaten is None else found.basins[int(np.argmax(np.where(errors > NEAR_DEG, values, -np.inf)))]
    return Looked(row, Views(found.hill.scene.data, _pictures(truth), None if other is None else _pictures(other)))


def off(held: Articulation, rng: np.random.Generator) -> Array:
    """(1, 6 + J) step away from the truth: its sizes are always the same, its direction is drawn."""
    turn, place = rng.normal(size=3), rng.normal(size=2)
    joints = [_OFF_DEG if j.kind == "revolute" else _OFF_SHARE * (j.maximum - j.minimum) for j in held.joints]
    signs = rng.choice([-1.0, 1.0], size=1 + len(joints))
    return np.concatenate(
        [
            np.deg2rad(_OFF_DEG) * turn / np.linalg.norm(turn),
            _OFF_PX * place / np.linalg.norm(place),
            signs * np.array([np.log1p(_OFF_SCALE), *joints]),
        ]
    )[None]


def _sun(shared: _Pass, found: Found) -> Array:
    """From where the truth climbs: the Sun that is told; else the true one; else that of what is found, or any."""
    if shared.told.towards_sun is not None:
        return shared.told.towards_sun
    true = shared.case.towards_sun
    if true is not None:
        return np.asarray(true / np.linalg.norm(true))
    return found.basins[0].sun if found.basins else _ASIDE


def _climbed(hill: Hill, poses: Poses, sun: Array) -> list[Refined]:
    return ascend(hill, poses, np.tile(sun, (len(poses), 1)), steps=_CLIMB)


def _twin_margin(truth: Refined, twins: Sequence[Refined], likeness: Likeness) -> float | None:
    if not twins:
        return None
    return twin_margin(truth.log_posterior, _values(twins), _errors(likeness, twins))


def _errors(likeness: Likeness, found: Sequence[Refined]) -> Array:
    return likeness.errors_deg(concatenate(*(one.pose for one in found))) if found else np.zeros(0)


def _values(found: Sequence[Refined]) -> Array:
    return np.array([one.log_posterior for one in found])


def _pictures(at: Refined) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Copies: they do not keep the rest of a fit, which is a hundred times as large."""
    return at.fit.model.copy(), at.fit.residual.copy()


def _rough_nats(hill: Hill, at: Refined) -> float:
    """What samples and texels leave: standard deviation of the evidence about a parabola, within one sigma of a pose.

    Poses lie along a direction that is drawn; without it their evidence would be all but a parabola.
    """
    values, vectors = np.linalg.eigh(at.covariance)
    drawn = np.random.default_rng(0).normal(size=len(values))
    along = vectors @ (np.sqrt(np.maximum(values, 0.0)) * drawn / np.linalg.norm(drawn))
    places = np.linspace(-1, 1, _ROUGH_POSES)
    poses = retract(at.pose[np.zeros(_ROUGH_POSES, dtype=np.intp)], places[:, None] * along)
    found = hill.log_evidences(hill.drawing.cut(poses, at.sun, hill.view, hill.quality))
    return float(np.std(found - np.polyval(np.polyfit(places, found, 2), places)))


def _evidence_ms(hill: Hill, at: Refined) -> float:
    planes = hill.drawing.cut(at.pose, at.sun, hill.view, hill.quality)
    return _median_ms(lambda: hill.log_evidences(planes))


def _draw_us(hill: Hill, at: Refined) -> float:
    """Of one of 64 poses around this one, 64 px a side."""
    view = View(hill.view.origin, hill.view.binning * hill.view.side / _DRAWN_SIDE, _DRAWN_SIDE)
    steps = np.zeros((_DRAWN, 6 + at.pose.joints.shape[1]))
    steps[:, :3] = _DRAWN_SPREAD * np.random.default_rng(0).normal(size=(_DRAWN, 3))
    poses = retract(at.pose[np.zeros(_DRAWN, dtype=np.intp)], steps)
    shares = np.ascontiguousarray(at.fit.coefficients, np.float32)
    return 1e3 / _DRAWN * _median_ms(lambda: hill.drawing.combined(poses, at.sun, shares, view, _DRAWN_QUALITY))


def _median_ms(call: Callable[[], object]) -> float:
    spent = []
    for _ in range(_REPEATS):
        began = time.perf_counter()
        call()
        spent.append(1e3 * (time.perf_counter() - began))
    return median(spent)
