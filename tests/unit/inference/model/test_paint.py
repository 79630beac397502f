"""What a mode learns of its body's paint: from frames made with known albedos, and what it then expects."""

from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
from lit_body import FINEST, SUN, VIEW, lit_body, pose, scene, seen, shares

from service.inference.model import paint, prior
from service.inference.model.drawing import Quality
from service.inference.model.likelihood import Fit, fit_light
from service.inference.model.terms import Terms, positive_priors, terms_of
from service.inference.numerics.curvature import paint_variance
from service.inference.pose import retract

SIGMA = 4.0
ALBEDO = (1.0, 1.6, 0.5)
DRAWN = Quality(supersample=4, shadow_px=192)


def planes(turn: float) -> np.ndarray:
    at = retract(pose(), np.array([[0, turn, 0, 0, 0, 0, 0.0]]))
    return lit_body().planes(at, SUN, VIEW, DRAWN)


def fitted(
    turn: float, seed: int, gain: float = 700.0, known: np.ndarray | None = None, albedo=ALBEDO
) -> tuple[Fit, Terms]:
    at = retract(pose(), np.array([[0, turn, 0, 0, 0, 0, 0.0]]))
    image = seen(at, shares(lit_body(), gain, albedo, gloss=0.02))
    given = scene(image + np.random.default_rng(seed).normal(0, SIGMA, image.shape), SIGMA, low_pass=FINEST)
    drawn = planes(turn)
    terms = terms_of(given, lit_body().n_groups, drawn.shape[1])
    under = terms if known is None else paint.painted(terms, known[None])
    answers, details = lit_body().light.details(drawn, lit_body().n_groups, under, 6)
    parts = (getattr(details[0], field.name) for field in fields(details[0]))
    ended = answers.coefficients[0], answers.values[0]
    fit = Fit(drawn[0], float(answers.log_evidence[0]), float(answers.chi2[0]), *ended, *parts)
    return fit, terms


def followed(n: int) -> np.ndarray:
    """What is known after so many frames of a turning body, under air that lets more or less through."""
    known = paint.unlearnt(planes(0.0).shape[1])
    for k in range(n):
        known = paint.expected(known, 0.05) if k else known
        fit, terms = fitted(0.05 * k, k, 700.0 * 1.3 ** (-1) ** k, known)
        variance = paint_variance(fit, np.zeros((1, VIEW.side, VIEW.side)), np.zeros((1, 1)))
        known = paint.learnt(fit, terms, known, variance)
    return known


def test_albedos_are_learnt_beside_the_gain():
    known = followed(4)
    groups = lit_body().n_groups
    found = known[0, :groups] - known[0, 0]
    wanted = np.log(np.array(ALBEDO)[:groups] / ALBEDO[0])
    assert found == pytest.approx(wanted, abs=0.1)
    assert (known[1, :groups] > 100.0).all()


def test_a_frame_is_less_of_a_surprise_once_the_paint_is_known_and_other_paint_is_one():
    known = paint.expected(followed(4))
    gains = [
        fitted(0.2, 9, known=known, albedo=albedo)[0].log_evidence - fitted(0.2, 9, albedo=albedo)[0].log_evidence
        for albedo in (ALBEDO, (1.0, 0.3, 2.5))
    ]
    assert gains[0] > 2.0 and gains[1] < -20.0


def test_the_light_of_poses_with_paint_of_their_own_is_that_of_the_readable_twin():
    drawn = np.concatenate([planes(0.0), planes(0.1)])
    n_groups, n_planes = lit_body().n_groups, drawn.shape[1]
    image = seen(pose(), shares(lit_body(), 300.0, ALBEDO))
    terms = terms_of(scene(image, SIGMA, low_pass=FINEST), n_groups, n_planes)
    rng = np.random.default_rng(0)
    known = np.stack([rng.normal(0, 0.5, (2, n_planes - 4)), rng.uniform(0, 80, (2, n_planes - 4))], axis=1)
    known[0, 1] = 0.0  # of the first nothing
    both = paint.painted(terms, known)
    found, details = lit_body().light.details(drawn, n_groups, both, 6)
    for k in range(2):
        own = replace(both, mean=both.mean[k], precision=both.precision[k])
        twin = fit_light(drawn[k], n_groups, own)
        assert found.log_evidence[k] == pytest.approx(twin.log_evidence, abs=0.5)
        assert found.coefficients[k] == pytest.approx(twin.coefficients, rel=0.02, abs=0.5)
        assert np.array_equal(details[k].lit, twin.lit)
    plain = lit_body().light.evidence(drawn[:1], n_groups, terms, 6)
    assert found.log_evidence[0] == pytest.approx(plain.log_evidence[0], abs=1e-3)


def test_information_adds_up_as_the_fading_memory_says_and_wears_off():
    """One number seen with a known precision: the closed form."""
    own, frame = prior.ALBEDO_SIGMA**-2, 25.0
    known = np.zeros((2, 1))
    for value in (0.3, 0.5, 0.4):
        before = known[1, 0]
        precision = own + before
        expected = known[0, 0] * before / precision
        total = precision + frame
        after = (precision * expected + frame * value) / total
        fit = SimpleNamespace(lit=np.array([0]), values=np.array([after]))
        offset, alone, facets = positive_priors(1, 5)
        terms = SimpleNamespace(offset=offset, precision=alone, facets=facets)
        mean = (known[0, 0] * before + frame * value) / (before + frame)
        known = paint.learnt(fit, terms, known, np.array([1 / total]))
        assert known[0, 0] == pytest.approx(mean)
        assert known[1, 0] == pytest.approx(frame + prior.MEMORY_KEPT * before)
    later = paint.expected(known)
    assert 1 / later[1, 0] == pytest.approx(1 / known[1, 0] + prior.PAINT_DRIFT**2)
    assert later[0, 0] == known[0, 0]
