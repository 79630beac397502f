"""Facets whose paint is alike, on the device: the readable twin, and what is known of them otherwise."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from test_evidence import FORMS, SHARP, TURBULENT, agrees, scene_of, wedges

from gpu.evidence import LightEvidence, open_evidence
from service.inference.model.likelihood import ROUNDS, fit_light
from service.inference.model.paint import painted
from service.inference.model.terms import Terms, terms_of

GROUPS = 6
PIECES = np.array([0, 0, 1, 2, 2, 2], np.int32)


@pytest.fixture(scope="module", params=FORMS, ids=["groups" if together else kind for kind, together in FORMS])
def light(request) -> Iterator[LightEvidence]:
    opened = open_evidence(*request.param)
    yield opened
    opened.close()


def given(pieces: np.ndarray | None, spread=TURBULENT, shifts=True) -> tuple[np.ndarray, Terms]:
    rng = np.random.default_rng(11)
    planes = np.stack([wedges(rng, 48, GROUPS, GROUPS) for _ in range(3)])
    return planes, terms_of(scene_of(rng, planes[0], GROUPS, spread, shifts), GROUPS, planes.shape[1], pieces)


@pytest.mark.parametrize("spread, shifts", [(SHARP, False), (TURBULENT, True)])
@pytest.mark.parametrize("rounds", [1, ROUNDS])
def test_evidence_is_the_twins(light, spread, shifts, rounds):
    planes, terms = given(PIECES, spread, shifts)
    found = light.evidence(planes, GROUPS, terms, rounds)
    assert terms.facets.any
    for k, one in enumerate(planes):
        twin = fit_light(one, GROUPS, terms, rounds)
        agrees(found, k, twin)
        np.testing.assert_allclose(found.values[k], twin.values, atol=1e-2)


def test_curvature_and_pull_are_the_twins(light):
    planes, terms = given(PIECES)
    _, details = light.details(planes, GROUPS, terms, ROUNDS)
    for one, told in zip(planes, details, strict=True):
        twin = fit_light(one, GROUPS, terms)
        assert len(twin.lit) < 2 * GROUPS  # some are dark
        root = np.sqrt(np.diag(twin.normal))
        np.testing.assert_allclose(told.normal / np.outer(root, root), twin.normal / np.outer(root, root), atol=2e-3)
        np.testing.assert_array_equal(told.lit, twin.lit)
        np.testing.assert_allclose(told.deviation, twin.deviation, atol=1e-2)


def test_paint_that_was_learnt_of_dark_facets_tells_what_is_lit(light):
    planes, terms = given(PIECES)
    known = np.zeros((1, 2, 2 * GROUPS))
    known[0, :, 5] = -1.2, 400.0  # the last wedge is dark
    both = painted(terms, known)
    found = light.evidence(planes[:1], GROUPS, both, ROUNDS)
    agrees(found, 0, fit_light(planes[0], GROUPS, replace(both, mean=both.mean[0], precision=both.precision[0])))
    plain = light.evidence(planes[:1], GROUPS, terms, ROUNDS)
    assert abs(found.log_evidence[0] - plain.log_evidence[0]) > 0.1


def test_facets_that_differ_by_nothing_are_one_surface(light):
    """A piece whose facets all have much own precision: evidence is that of the piece drawn as one."""
    planes, terms = given(np.array([0, 0, 1, 1, 2, 2], np.int32), SHARP, False)
    planes[:, 5] = 0.3 * planes[:, 6]  # no group is dark
    tight = np.where(terms.facets.own > 0, np.float32(1e6), np.float32(0.0))
    whole = terms_of(terms.scene, 3, 3 + 4 + GROUPS)  # gloss is each group's own
    common = np.where(terms.facets.own > 0, whole.precision[0], 0.0).astype(np.float32)
    facets = type(terms.facets)(terms.facets.piece, tight, common)
    precision = np.where(tight > 0, tight, terms.precision[: 2 * GROUPS])
    precision = np.concatenate([precision, terms.precision[2 * GROUPS :]])
    alike = replace(terms, facets=facets, precision=precision)
    albedos = planes[:, :6].reshape(3, 3, 2, 48, 48).sum(2)
    joined = np.concatenate([albedos, planes[:, 6:]], axis=1)
    found, one = light.evidence(planes, GROUPS, alike, ROUNDS), light.evidence(joined, 3, whole, ROUNDS)
    assert found.log_evidence == pytest.approx(one.log_evidence, abs=0.1)
