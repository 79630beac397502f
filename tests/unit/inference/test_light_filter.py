"""The filter of docs/model.md on frames that its own model draws: followed, lost, empty, and again from its state."""

from __future__ import annotations

import functools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from held_mixture import HELD, mixture
from lit_body import QUALITY, SUN, lit_body, shares

from service.imaging.patch import Light
from service.inference.domain import Domain
from service.inference.filters import mixture as filtering
from service.inference.filters.answer import drawn
from service.inference.filters.given import Given
from service.inference.filters.mixture import is_another, step
from service.inference.filters.status import SURE, status_of, told_existence
from service.inference.filters.weighing import born
from service.inference.held import Held
from service.inference.model import prior
from service.inference.model import search as searching
from service.inference.model.drawing import Lens, View
from service.inference.model.paint import unlearnt
from service.inference.model.search import make_bank, search
from service.inference.model.spread import PointSpread, spread
from service.inference.model.stages import Body
from service.inference.motion import motion_noise
from service.inference.numerics.hill import Refined
from service.inference.numerics.priors import PosePrior
from service.inference.pose import angle_between, retract
from service.inference.state import FilterState, Poses
from service.sessions.config import effective
from service.workers.codec import decode, encode
from service.workers.lit_frame import LightOfFrame

SIZE, SIGMA, DT_S = 144, 4.0, 0.1
TOLD = PosePrior(towards_sun=SUN)
RATE = np.array([[0.12, -0.2, 0.1, 5.0, -3.0, 0.0]])  # rad and px per s


class Drawn(LightOfFrame):
    """A frame whose sky is known to be even."""

    def __init__(self, image: np.ndarray, lens: Lens | None = None, known_px: float = 0.0) -> None:
        self._lens, self._known_px = lens, known_px
        self._whole = Light(image.astype(np.float32), SIGMA, 1e-3, 1.0, np.zeros(image.shape, bool))
        self._psf_px, self._region = 1.3, None


@functools.cache
def body() -> Body:
    drawing = lit_body()
    drawing = replace(drawing, articulation=replace(drawing.articulation, joints=()))
    return Body(drawing, drawing, drawing)


@functools.cache
def bank():
    searching.BANK_SIZE, held = 1500, searching.BANK_SIZE
    try:
        return make_bank(body(), TOLD)
    finally:
        searching.BANK_SIZE = held


def truth(k: int) -> Poses:
    start = Poses(
        np.array([[0.6, -0.4, 0.5, 0.48]]) / np.linalg.norm([0.6, -0.4, 0.5, 0.48]),
        np.array([[70.0, 75.0]]),
        np.log([26.0 / lit_body().radius]),
        np.zeros((1, 0)),
    )
    return retract(start, RATE * DT_S * k)


def frame(k: int, gain: float = 700.0, lens: Lens | None = None) -> Drawn:
    drawing = body().fine
    picture = drawing.combined(truth(k), SUN, shares(drawing, gain), View((0.0, 0.0), 1.0, SIZE, lens), QUALITY)
    noise = np.random.default_rng(k).normal(0, SIGMA, (SIZE, SIZE))
    return Drawn(spread(picture, PointSpread(1.3), 0.0)[0] + noise, lens)


def given(light: Drawn, k: int) -> Given:
    config = effective({})
    domain = Domain(SIZE, SIZE, body().fine.radius, body().fine.articulation, config.prior)
    return Given(light, body(), bank, TOLD, config, domain, (), k, DT_S * k)


def advance(state: FilterState | None, light: Drawn, k: int):
    return step(np.random.default_rng([7, k]), state, given(light, k))


@functools.cache
def passed():
    """States and answers: three frames, three empty ones, two with the body again."""
    state, told = None, []
    for k in range(8):
        state, estimate = advance(state, frame(k, 0.0 if 3 <= k < 6 else 700.0), k)
        told.append((state, estimate))
    return told


def error_deg(estimate, k: int) -> float:
    return float(np.rad2deg(angle_between(estimate.best.quaternion, truth(k).quaternion[0])))


def test_a_body_is_found_followed_and_its_rates_are_known():
    told = passed()
    assert [error_deg(told[k][1], k) < 3.0 for k in range(3)] == [True] * 3
    assert [estimate.status for _, estimate in told[:3]] == ["tracking"] * 3
    found = told[2][0].mixture
    deviation = np.sqrt(np.diag(found.covariance[0])[6:9])
    assert np.abs(found.rates[0, :3] - RATE[0, :3]).max() < 4 * deviation.max()
    for _, estimate in told[:3]:
        assert estimate.probabilities.sum() == pytest.approx(1.0)
        assert estimate.fit.explained > 0.8 and estimate.fit.covered_dark < 0.5
        assert sum(mode.weight for mode in estimate.modes) == pytest.approx(1.0)


def test_a_settled_track_has_its_search_in_parts_and_counts_it_when_all_are_done(monkeypatch):
    state, parts, plain = passed()[2][0], [], filtering.rivals
    monkeypatch.setattr(filtering, "rivals", lambda *look: parts.append(look[4]) or plain(*look))
    monkeypatch.setattr(filtering, "search", lambda *look, **how: pytest.fail("a whole search"))
    held, counts = replace(state.mixture, searches=4, searched_nats=340.0, ever_tracked=True, parts_searched=0), []
    for k in range(3, 8):
        state = replace(state, mixture=replace(held, since_search=16))  # the next of five parts is due
        state, estimate = advance(state, frame(k), k)
        held = state.mixture
        counts.append((held.searches, held.parts_searched, held.since_search))
        assert estimate.status == "tracking" and error_deg(estimate, k) < 3.0
    assert [part.number for part in parts] == list(range(parts[0].count)) == list(range(5))
    assert counts == [(4, 1, 17), (4, 2, 17), (4, 3, 17), (4, 4, 17), (5, 0, 0)]


def test_a_track_that_is_wrong_is_bettered_by_the_part_that_meets_the_truth():
    state = passed()[2][0]
    turned = retract(state.mixture.poses, 0.6 * np.eye(6)[1:2])
    held = replace(state.mixture, poses=turned, rates=0 * state.mixture.rates, searches=6, ever_tracked=True)
    for k in range(3, 11):
        state = replace(state, mixture=replace(held, since_search=100))
        state = advance(state, frame(k), k)[0]
        held = state.mixture
        if held.misses:
            break
    assert held.misses == 6 and held.searches <= 1  # six had missed what leads now, and it is searched whole again
    assert error_deg(advance(state, frame(k + 1), k + 1)[1], k + 1) < 3.0


def test_a_body_two_diameters_away_is_found_through_its_lens():
    """Half of it is seen larger by a third than the other, from 20 degrees aside."""
    lens, state = Lens(100.0, (32.0, 72.0)), None
    for k in range(2):
        state, estimate = advance(state, frame(k, lens=lens), k)
        assert error_deg(estimate, k) < 2.0
        assert np.abs(estimate.best.position - truth(k).position[0]).max() < 0.3
    assert estimate.status == "tracking"


def test_an_empty_frame_shows_no_target_and_the_body_is_found_again():
    told = passed()
    assert [estimate.status for _, estimate in told[3:6]] == ["no_target"] * 3
    assert all(estimate.probabilities[0] > 0.9 for _, estimate in told[3:6])
    for k in (6, 7):
        assert told[k][1].status == "tracking" and error_deg(told[k][1], k) < 3.0
    wide = [estimate.spread.orientation_deg for _, estimate in told]
    assert wide[5] > wide[3] > wide[2]


def test_a_told_attitude_mode_weighs_the_answer_and_nothing_that_is_carried_on():
    state, plain = passed()[1][0], passed()[2]
    told = Held("nadir_pointing", tuple(truth(2).quaternion[0].tolist()))
    after, estimate = step(np.random.default_rng([7, 2]), state, replace(given(frame(2), 2), held=told))
    for name in ("log_weights", "covariance", "existence", "paint"):
        assert np.array_equal(getattr(after.mixture, name), getattr(plain[0].mixture, name))
    assert estimate.status == "tracking" and error_deg(estimate, 2) < 3.0


def test_a_mesh_that_is_off_widens_the_answer_and_no_pose_that_is_carried_on():
    (state, _), (held, plain), asked = *passed()[1:3], given(frame(2), 2)
    off = replace(asked.domain, prior=replace(asked.domain.prior, mesh_error=0.05))
    after, told = step(np.random.default_rng([7, 2]), state, replace(asked, domain=off))
    assert np.array_equal(after.mixture.covariance, held.mixture.covariance) and told.status == plain.status
    assert told.spread.orientation_deg > plain.spread.orientation_deg + 1.0


def test_a_state_that_was_stored_goes_on_as_if_it_had_not_been():
    state = passed()[1][0]
    again = advance(decode(FilterState, encode(state)), frame(2), 2)[0]
    held = passed()[2][0]
    assert np.array_equal(again.poses.quaternion, held.poses.quaternion)
    assert np.array_equal(again.mixture.covariance, held.mixture.covariance)
    assert again.mixture.existence.tolist() == held.mixture.existence.tolist()


def test_an_empty_sky_from_the_start_is_no_target():
    state, estimate = advance(None, Drawn(np.random.default_rng(0).normal(0, SIGMA, (SIZE, SIZE))), 0)
    assert estimate.status == "no_target" and state.mixture is None
    assert advance(state, frame(1), 1)[1].status == "tracking"


def test_another_body_does_not_fit(monkeypatch):
    """Bright all over, where the model can only be bright where the Sun is."""
    at = np.arange(SIZE)
    blob = (
        700.0
        * ((np.abs(at - 70)[:, None] < 9) ^ (np.abs(at - 75)[None] < 22))
        * ((np.abs(at - 70)[:, None] < 24) & (np.abs(at - 75)[None] < 40))
    )
    checks = blob * (1 + np.sign(np.sin(at / 3.0)[:, None] * np.sin(at / 4.0)[None])) / 2
    state, statuses, looks = None, [], []
    monkeypatch.setattr(filtering, "search", lambda *look, **how: looks.append(how) or search(*look, **how))
    advance(None, frame(0), 0)
    assert len(looks) == 1  # a body that fits is searched once
    looks.clear()
    for k in range(4):
        noise = np.random.default_rng(k).normal(0, SIGMA, (SIZE, SIZE))
        state, estimate = advance(
            state, Drawn(spread(checks[None].astype(np.float32), PointSpread(1.3), 0.0)[0] + noise), k
        )
        statuses.append(estimate.status)
        if k == 0:  # and once more in its first frame, about what was met, where nothing fits
            assert statuses == ["no_fit"] and len(looks) == 2
            assert looks[1]["track"].doubted and looks[1]["shake"]
    assert statuses[-1] in ("no_fit", "ambiguous", "acquiring")


@pytest.mark.parametrize(
    ("held", "status"),
    [
        (mixture(), "tracking"),
        (mixture(searches=1), "acquiring"),
        (mixture((0.6, 0.4)), "ambiguous"),
        (mixture((0.6, 0.4), searches=1), "acquiring"),
        (mixture(searches=3, misses=4, ever=True), "ambiguous"),
        (mixture((0.6, 0.4), ever=True), "ambiguous"),
        (mixture(existence=(0.0, 0.2, 0.8)), "no_fit"),
        (mixture(existence=(0.0, 0.2, 0.8), ever=True), "lost"),
        (mixture(existence=(0.95, 0.05, 0.0)), "no_target"),
        (mixture(discrepancy=0.025), "acquiring"),
        (mixture(discrepancy=0.064, ever=True), "lost"),
    ],
)
def test_status_is_read_off_the_probabilities(held, status):
    assert status_of(held, (), given(frame(0), 0).domain) == status
    assert told_existence(held).sum() == pytest.approx(1.0)


def test_a_cloud_is_no_paint():
    """A search under it finds the body where it is, with other paint."""
    state = advance(None, frame(0), 0)[0]
    for k in (1, 2):
        state, estimate = advance(state, frame(k), k)
    assert estimate.status == "tracking"
    clear = frame(3)._whole.image
    through = np.where(np.arange(SIZE) < 72, 0.1, 1.0)
    under = Drawn(clear * through + np.random.default_rng(9).normal(0, SIGMA, clear.shape) * (through < 1))
    before = replace(state, mixture=replace(state.mixture, searches=0))  # due
    assert advance(before, under, 3)[1].status in ("lost", "no_fit", "ambiguous")


def test_a_wide_basin_is_worth_no_more_beside_a_track_than_a_narrow_one():
    """A frame that says little is fitted as well from everywhere: it must not take a track away."""
    noise, domain = motion_noise(effective({}).motion, given(frame(0), 0).domain), given(frame(0), 0).domain
    fit = SimpleNamespace(coefficients=np.zeros(7))

    def weight(wide: float, level: float | None, siblings: int = 1) -> float:
        one = Refined(truth(0), SUN, 0.0175, fit, -100.0, wide**2 * np.eye(6), np.zeros(3))
        return born(one, level, siblings, unlearnt(7), noise, domain).log_weight

    assert weight(0.5, 0.0) == weight(0.01, 0.0) == pytest.approx(prior.EVIDENCE_TRUST * -100 + np.log(0.1))
    assert weight(0.5, 0.0, 4) == pytest.approx(prior.EVIDENCE_TRUST * -100 + np.log(0.1 / 4))
    assert weight(0.5, None) > weight(0.01, None)  # nothing is known yet: the frame's own shares


def test_a_basin_near_a_mode_that_it_betters_is_no_other_answer():
    """A joint that a glint puts right: earlier searches have not missed the truth, so the track is not doubted."""
    here, there = truth(0), retract(truth(0), np.deg2rad([[30.0, 0, 0, 0, 0, 0]]))
    close = retract(truth(0), np.deg2rad([[3.0, 0, 0, 0, 0, 0]]))

    def another(poses: list[Poses], n_followed: int) -> bool:
        refined = [SimpleNamespace(pose=pose) for pose in poses]
        leads_last = np.arange(len(poses), dtype=float)
        return is_another(
            SimpleNamespace(refined=refined, log_weights=leads_last, n_followed=n_followed), given(frame(0), 0)
        )

    assert not another([there, here], 2)  # followed
    assert not another([here, close], 1)
    assert another([here, there], 1)
    assert another([here], 0)


def test_particles_have_their_modes_shares():
    poses, rates = drawn(np.random.default_rng(0), mixture((0.7, 0.3)), 1000, given(frame(0), 0).domain)
    near = np.rad2deg(angle_between(poses.quaternion, HELD.quaternion[0])) < 20
    assert len(poses) == len(rates) == 1000 and abs(int(near.sum()) - 700) <= 2
    assert SURE == 0.9
