"""Cases through the tracker: every entry follows the same frames, each with its own session."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any

import numpy as np

from service.bench.ablation import altered
from service.bench.brightness import SkyLevel
from service.bench.cases import Case
from service.bench.scoring import FrameScore, Referee
from service.bench.silhouette import whole_pixels
from service.bench.told import Told
from service.inference.light import Light
from service.inference.params import JointParams, SessionConfig
from service.inference.state import FilterState
from service.sessions.frame import own_sky_frames
from service.sessions.lighting import light_at
from service.sessions.ranging import scale_bounds
from service.workers.base import BackgroundJob, FrameJob, FrameReport
from service.workers.tracker import Tracker, content_key

_PNG = "image/png"
_WARM_PARTICLES = 64
_BORDER_SHARE = 12  # without a background: the sky of a border of this part of the image's width
SETTLED_FRAME = 10


@dataclass(frozen=True)
class Entry:
    """One contestant: a configuration by name. ``twins`` False: the filter is not told of the body's symmetries."""

    name: str
    config: SessionConfig
    twins: bool = True
    says: str = ""
    priors: Mapping[str, Any] = field(default_factory=dict)  # see ``ablation.Variant``


@dataclass(frozen=True)
class CaseResult:
    """An entry's answers to a case. ``facts``: conditions of the pass, such as ``snr``, ``size_px``, ``d_over_r0``."""

    entry: str
    case: str
    frames: tuple[FrameScore, ...]
    facts: Mapping[str, float]
    n_joints: int
    scorer: str
    settled_frame: int = SETTLED_FRAME  # visible frames before it count for acquisition only


@dataclass(frozen=True)
class Terms:
    """How passes are run. ``limit``: only so many frames of each; ``settled_frame`` as in ``CaseResult``."""

    limit: int | None = None
    settled_frame: int = SETTLED_FRAME
    told: Told = field(default_factory=Told)


@dataclass
class BenchSession:
    """What an entry carries along a pass."""

    entry: Entry
    case: Case
    config: SessionConfig
    background: str
    blobs: Mapping[str, bytes]
    state: FilterState | None = None
    scorer: str = ""
    scores: list[FrameScore] = field(default_factory=list)

    def track(
        self, tracker: Tracker, index: int, time_s: float, body: bytes, light: Light | None = None
    ) -> FrameReport:
        """One frame as the service would run it; ``light``: other than what the configuration says."""
        job = self._job(self.config, index, time_s, body)
        with altered(self.entry.priors):
            report = tracker.track(job if light is None else replace(job, light=light))
        self.state, self.scorer = report.state, report.scorer
        return report

    def warm_up(self, tracker: Tracker, body: bytes) -> None:
        """Let the tracker prepare device and caches, on a frame whose answer is thrown away."""
        few = replace(self.config.filter, particles=_WARM_PARTICLES)
        tracker.track(self._job(replace(self.config, filter=few), 0, 0.0, body))

    def _job(self, config: SessionConfig, index: int, time_s: float, body: bytes) -> FrameJob:
        model = self.case.model
        return FrameJob(
            config=config,
            model=model.key,
            file_type=model.file_type,
            articulation=model.articulation,
            background=self.background,
            state=self.state,
            frame_index=index,
            time_s=time_s,
            body=body,
            media_type=_PNG,
            blobs=self.blobs,
            twins=model.twins if self.entry.twins else (),
            scale_px=scale_bounds(config.prior, None),
            light=light_at(config, {}).light,
        )


def run_case(
    tracker: Tracker,
    case: Case,
    entries: Sequence[Entry],
    terms: Terms | None = None,
    progress: Callable[[int], None] = lambda frames: None,
) -> list[CaseResult]:
    """Run all entries over a case, frame by frame; no image is kept. ``progress`` hears how many frames are done."""
    terms = terms or Terms()
    case = terms.told.shown(case)
    referee = Referee(case)
    backgrounds = list(case.backgrounds())
    sessions = [open_session(tracker, case, entry, backgrounds, terms.told) for entry in entries]
    sky = SkyLevel(backgrounds) if backgrounds else None
    del backgrounds
    snr, size_px = [], []
    for index, (body, truth) in enumerate(islice(case.frames(), terms.limit)):
        real = referee.draw(truth.poses(referee.articulation)) if truth.visible else None
        if real is not None:
            snr.append(sky.snr(body, whole_pixels(real)) if sky else np.nan)
            size_px.append(2 * case.model.mesh.radius * truth.scale)
        for session in sessions:
            if index == 0:
                session.warm_up(tracker, body)
            began = time.perf_counter()
            report = session.track(tracker, index, truth.time_s, body, terms.told.light_at(truth))
            ms = 1e3 * (time.perf_counter() - began)
            session.scores.append(referee.score(index, truth, real, report.estimate, ms))
        progress(index + 1)
    facts = {**case.facts, **_medians(snr=snr, size_px=size_px)}
    joints, first = referee.articulation.n_joints, terms.settled_frame
    return [CaseResult(s.entry.name, case.name, tuple(s.scores), facts, joints, s.scorer, first) for s in sessions]


def open_session(tracker: Tracker, case: Case, entry: Entry, backgrounds: Sequence[bytes], told: Told) -> BenchSession:
    """A contestant at the start of a pass: what it is told, and its sky."""
    config = told.configure(replace(entry.config, joints=JointParams(free=case.free)), case)
    learned = learned_sky(tracker, case, config, backgrounds) if told.sky else own_sky(tracker, case, config)
    key = content_key(learned)
    return BenchSession(entry, case, config, key, {case.model.key: case.model.data, key: learned})


def learned_sky(tracker: Tracker, case: Case, config: SessionConfig, backgrounds: Sequence[bytes]) -> bytes:
    """The sky, of empty frames; where there is none, of the first frame outside of the told box, or of its border."""
    learned: bytes | None = None
    for body in backgrounds:
        learned = tracker.learn_background(BackgroundJob(config, body, _PNG, learned)).background
    if learned is None:
        first, _ = next(case.frames())
        border = None if case.box else case.size[0] // _BORDER_SHARE
        job = BackgroundJob(config, first, _PNG, None, box=case.box, border_px=border)
        learned = tracker.learn_background(job).background
    return learned


def own_sky(tracker: Tracker, case: Case, config: SessionConfig) -> bytes:
    """The sky of a session to which nobody posts an empty frame, all of it learned ahead."""
    learned: bytes | None = None
    for body, _ in own_sky_frames(case.frames()):
        learned = tracker.learn_background(BackgroundJob(config, body, _PNG, learned, own=True)).background
    assert learned is not None, "a case has at least one frame"
    return learned


def _medians(**values: Sequence[float]) -> dict[str, float]:
    return {name: float(np.nanmedian(found)) for name, found in values.items() if np.any(np.isfinite(found))}
