"""The light's evidence on the device, against its readable twin."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from gpu.device import find_devices
from gpu.evidence import LightEvidence, open_evidence
from service.inference.model.drawing import EVEN_PLANES
from service.inference.model.likelihood import ROUNDS, Fit, fit_light
from service.inference.model.paint import painted
from service.inference.model.scene import Scene
from service.inference.model.spread import PointSpread, spread
from service.inference.model.terms import terms_of

KINDS = sorted({report.kind for report in find_devices() if report.rejected is None})
FORMS = [(kind, None) for kind in KINDS] + [("cpu", True)] * ("cpu" in KINDS)  # a GPU's form runs on a CPU, too
NATS, RELATIVE = 0.05, 1e-3
SHARP, TURBULENT = PointSpread(1.2), PointSpread(1.0, 0.8)
CASES = {  # side, groups, gloss planes, point spread, speckle and shifts
    "least patch": (16, 2, 0, SHARP, False),
    "least patch, all unknowns": (16, 3, 3, TURBULENT, True),
    "coarse": (48, 6, 0, SHARP, False),
    "coarse, wings": (48, 5, 5, TURBULENT, False),
    "speckle": (48, 5, 5, SHARP, True),
    "speckle and shifts": (48, 4, 2, TURBULENT, True),
    "fine": (96, 12, 12, SHARP, True),
}


@pytest.fixture(scope="module", params=FORMS, ids=["groups" if together else kind for kind, together in FORMS])
def light(request) -> Iterator[LightEvidence]:
    kind, together = request.param
    opened = open_evidence(kind, together)
    yield opened
    opened.close()


def wedges(rng: np.random.Generator, side: int, groups: int, glossy: int) -> np.ndarray:
    """(Q, side, side): a dome cut like a cake, each piece evenly lit but the last, which is dark; gloss in spots."""
    y, x = np.mgrid[:side, :side] + 0.5
    cx, cy = rng.uniform(0.35, 0.65, 2) * side
    radius = rng.uniform(0.2, 0.4) * side
    disc = np.clip(radius - np.hypot(x - cx, y - cy), 0, 1)
    piece = np.floor((np.arctan2(y - cy, x - cx) / (2 * np.pi) + 0.5) * groups).clip(0, groups - 1)
    shades = rng.uniform(0.3, 1.0, groups) * (np.arange(groups) < max(groups - 1, 1))
    lit = disc * (piece == np.arange(groups)[:, None, None]) * shades[:, None, None]
    spots = [
        disc * np.exp(-0.5 * np.hypot(x - sx, y - sy) ** 2 / 1.5**2) for sx, sy in _places(rng, cx, cy, radius, glossy)
    ]
    spots = [spot * (spot > 1e-3) * (k % 3 > 0) for k, spot in enumerate(spots)]  # a third of them are empty
    across, down = (x - cx) / radius, (y - cy) / radius  # a dome, seen from above
    normals = disc * np.stack([across, down, -np.sqrt(np.maximum(1 - across**2 - down**2, 0.0))])
    return np.stack([*lit, disc, *normals, *spots]).astype(np.float32)


def _places(rng: np.random.Generator, cx: float, cy: float, radius: float, count: int) -> np.ndarray:
    return np.array([cx, cy]) + rng.uniform(-0.6, 0.6, (count, 2)) * radius


def scene_of(
    rng: np.random.Generator, planes: np.ndarray, groups: int, point_spread: PointSpread, shifts: bool, stars: int = 2
) -> Scene:
    """A noisy frame of the first pose's body and of stars, some of it brighter than pixels can tell."""
    albedo = np.exp(rng.normal(0, 0.5, len(planes)))
    albedo[groups:] *= 0.1
    albedo[groups + 1 : groups + EVEN_PLANES] = 0.02, -0.03, 0.01
    image = spread(np.tensordot(900.0 * albedo, planes, 1).astype(np.float32)[None], point_spread, 0.0)[0]
    image = image + rng.normal(0, 1, image.shape) * np.sqrt(25.0 + 0.5 * image)
    starry = np.zeros(image.shape, np.uint8)
    for number, at, bright in ((1, (2, 3), 400.0), (2, (len(image) - 5, 6), 30.0))[:stars]:
        image[at[0] : at[0] + 3, at[1] : at[1] + 3] += bright
        starry[at[0] : at[0] + 3, at[1] : at[1] + 3] = number
    most = float(np.quantile(image, 0.995))
    return Scene(
        image=np.minimum(image, most).astype(np.float32),
        sigma=5.0,
        photon=0.5,
        sky=40.0,
        full=image >= most,
        point_spread=point_spread,
        discrepancy=0.04,  # a smaller one would feel the wings that the kernel cuts off
        shifts=shifts,
        starry=starry,
        uneven=np.tile(np.linspace(0.8, 1.2, len(image), dtype=np.float32), (len(image), 1)),
    )


def agrees(answers, k: int, wanted: Fit) -> None:
    tolerance = NATS + RELATIVE * abs(wanted.log_evidence) * 0.2  # the kernel cuts wings off at 3.5 sigma
    assert answers.log_evidence[k] == pytest.approx(wanted.log_evidence, abs=tolerance)
    assert answers.chi2[k] == pytest.approx(wanted.chi2, rel=5e-2, abs=1e-3)  # a pixel is on the body or not
    scale = np.abs(wanted.coefficients).max()
    np.testing.assert_allclose(answers.coefficients[k], wanted.coefficients, rtol=RELATIVE, atol=RELATIVE * scale)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("rounds", [1, 4, ROUNDS])  # in between longer steps double what cut wings change
def test_evidence_is_the_twins(light, name, rounds):
    side, groups, glossy, point_spread, shifts = CASES[name]
    rng = np.random.default_rng(side + groups)
    planes = np.stack([wedges(rng, side, groups, glossy) for _ in range(4)])
    terms = terms_of(scene_of(rng, planes[0], groups, point_spread, shifts), groups, planes.shape[1])
    assert terms.full.any() and set(np.unique(terms.stars)) == {0, 1, 2}
    found = light.evidence(planes, groups, terms, rounds)
    for k, one in enumerate(planes):
        agrees(found, k, fit_light(one, groups, terms, rounds))


@pytest.mark.parametrize("name", ["coarse, wings", "speckle"])
def test_light_settles_under_poses_that_explain_little(light, name):
    """With steps of one length two thirds are settled after eighteen rounds: weights and light swing."""
    side, groups, glossy, point_spread, shifts = CASES[name]
    settled = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        planes = np.stack([wedges(rng, side, groups, glossy) for _ in range(12)])
        terms = terms_of(scene_of(rng, planes[0], groups, point_spread, shifts), groups, planes.shape[1])
        soon, late = (light.evidence(planes, groups, terms, rounds).log_evidence for rounds in (18, 80))
        settled += list(np.abs(soon - late) < 0.1)
    assert np.mean(settled) > 0.8


@pytest.mark.parametrize("name", ["least patch", "coarse, wings", "speckle and shifts"])
def test_details_are_what_the_twin_knows(light, name):
    side, groups, glossy, point_spread, shifts = CASES[name]
    rng = np.random.default_rng(7)
    planes = np.stack([wedges(rng, side, groups, glossy) for _ in range(2)])
    terms = terms_of(scene_of(rng, planes[0], groups, point_spread, shifts), groups, planes.shape[1])
    found, details = light.details(planes, groups, terms, ROUNDS)
    for k, one in enumerate(planes):
        wanted = fit_light(one, groups, terms)
        agrees(found, k, wanted)
        bright = float(np.abs(terms.data).max())
        for name in ("residual", "model", "light"):
            np.testing.assert_allclose(getattr(details[k], name), getattr(wanted, name), atol=RELATIVE * bright)
        told = ~terms.full  # where a star surely is, a weight has less than a float32's exponents
        np.testing.assert_allclose(details[k].weight[told], wanted.weight[told], rtol=1e-2, atol=1e-30)
        pull, expected = details[k].weight * details[k].residual, wanted.weight * wanted.residual
        np.testing.assert_allclose(pull, expected, atol=1e-2 * np.abs(expected).max())
        np.testing.assert_array_equal(details[k].precision, wanted.precision)
        np.testing.assert_allclose(details[k].deviation, wanted.deviation, atol=1e-2)
        window = details[k].window
        beyond = wanted.light.copy()
        beyond[window] = 0.0
        assert np.abs(beyond).max() < RELATIVE * bright
        for column, expected in zip(details[k].columns, wanted.columns[:, *window], strict=True):
            np.testing.assert_allclose(column, expected, atol=2e-3 * max(np.abs(expected).max(), 1e-3 * bright))


def test_poses_may_have_their_own_priors_point_spread_and_discrepancy(light):
    rng = np.random.default_rng(5)
    planes = np.stack([wedges(rng, 32, 4, 4) for _ in range(2)])
    scene = scene_of(rng, planes[0], 4, PointSpread(1.1, 0.8), True)
    scenes = [scene, scene.under(discrepancy=0.3), scene.under(point_spread=PointSpread(1.9, 1.4))]
    terms = [terms_of(one, 4, 12) for one in scenes]
    terms.append(painted(terms[0], rng.uniform(0.1, 3.0, (1, 2, 8))))
    which = [1, 0, 1, 0]
    found = light.evidence(planes, 4, terms, 4, which)
    alone = [light.evidence(planes[k : k + 1], 4, one, 4) for k, one in zip(which, terms, strict=True)]
    assert found.log_evidence.tolist() == [one.log_evidence[0] for one in alone]
    assert np.array_equal(found.coefficients, np.concatenate([one.coefficients for one in alone]))
    assert len(set(found.log_evidence.tolist())) == 4


@pytest.mark.parametrize("name", ["least patch, all unknowns", "coarse, wings", "speckle and shifts"])
def test_unknowns_go_on_where_others_ended(light, name):
    side, groups, glossy, point_spread, shifts = CASES[name]
    rng = np.random.default_rng(11)
    body = wedges(rng, side, groups, glossy)
    planes = np.stack([body, 0.9 * body])
    terms = terms_of(scene_of(rng, planes[0], groups, point_spread, shifts), groups, planes.shape[1])
    ended = light.evidence(planes, groups, terms, 1).values  # the next step still promises more than STILL
    assert ended.shape == (2, len(terms.mean))
    going = light.evidence(planes, groups, terms.begun(ended), 1)
    for k, one in enumerate(planes):
        agrees(going, k, fit_light(one, groups, terms.begun(ended[k : k + 1]), 1))
        np.testing.assert_allclose(ended[k], fit_light(one, groups, terms, 1).values, rtol=RELATIVE, atol=1e-2)
    settled = light.evidence(planes, groups, terms, 40)
    again = light.evidence(planes, groups, terms.begun(settled.values), 1)
    np.testing.assert_allclose(again.log_evidence, settled.log_evidence, atol=1e-2)


@pytest.mark.parametrize("goes_on", [False, True])
@pytest.mark.parametrize("count", [0, 1, 7])
def test_poses_do_not_hear_of_each_other(light, count, goes_on):
    rng = np.random.default_rng(3)
    planes = np.zeros((7, 12, 96, 96), np.float32)
    for k, at in enumerate((0, 60) * 3 + (0,)):  # in turn elsewhere: light that the one before leaves would show
        planes[k, :, at : at + 32, at : at + 32] = wedges(rng, 32, 4, 4)
    terms = terms_of(scene_of(rng, planes[0], 4, SHARP, True), 4, 12)
    if goes_on:
        terms = terms.begun(np.repeat(light.evidence(planes[:1], 4, terms, 4).values, 7, 0))
    whole = light.evidence(planes, 4, terms, 4)
    terms = terms if terms.start is None else replace(terms, start=terms.start[: max(count, 1)])
    some, more = light.details(planes[:count], 4, terms, 4)
    alone = replace(terms, start=None if terms.start is None else terms.start[:1])
    for k in range(7):
        one = light.evidence(planes[k : k + 1], 4, alone, 4)
        np.testing.assert_array_equal(one.log_evidence, whole.log_evidence[k : k + 1])
    assert some.log_evidence.shape == (count,) and some.coefficients.shape == (count, 12) and len(more) == count
    np.testing.assert_allclose(some.log_evidence, whole.log_evidence[:count], rtol=1e-6)
    np.testing.assert_allclose(some.coefficients, whole.coefficients[:count], rtol=1e-5)


def edge_cases() -> dict[str, np.ndarray]:
    """Planes of 3 groups and 3 gloss planes on 48 pixels: bodies that are hardly there."""
    one = wedges(np.random.default_rng(5), 48, 3, 3)
    nowhere, dark, dim, corner, pixel = (np.zeros_like(one) for _ in range(5))
    dark[3:7] = one[3:7]  # in shadow: even light only
    dim[:] = 2e-5 * one
    dim[3:7] = one[3:7]  # each plane below what counts as lit
    corner[:, -9:, -7:] = one[:, 20:29, 20:27]
    pixel[[0, 3, 5], 0, 47] = 0.7
    return {"nowhere": nowhere, "dark": dark, "dim": dim, "corner": corner, "pixel": pixel}


@pytest.mark.parametrize("point_spread", [SHARP, TURBULENT], ids=["sharp", "turbulent"])
@pytest.mark.parametrize("name", edge_cases())
def test_bodies_that_are_hardly_there(light, name, point_spread):
    planes = edge_cases()[name]
    rng = np.random.default_rng(6)
    terms = terms_of(scene_of(rng, wedges(rng, 48, 3, 3), 3, point_spread, True, stars=0), 3, 10)
    found = light.evidence(planes[None], 3, terms, ROUNDS)
    assert np.isfinite(found.coefficients).all()
    agrees(found, 0, fit_light(planes, 3, terms))


@pytest.mark.parametrize("full", [False, True], ids=["no pixel", "every pixel"])
def test_pixels_of_which_only_a_least_value_is_known(light, full):
    rng = np.random.default_rng(8)
    planes = wedges(rng, 32, 3, 3)
    scene = scene_of(rng, planes, 3, SHARP, True)
    terms = terms_of(replace(scene, full=np.full((32, 32), full)), 3, 10)
    agrees(light.evidence(planes[None], 3, terms, ROUNDS), 0, fit_light(planes, 3, terms))


def test_more_poses_than_fit_and_matrices_larger_than_local_memory(light, monkeypatch):
    rng = np.random.default_rng(2)
    planes = np.stack([wedges(rng, 32, 4, 4) for _ in range(5)])
    terms = terms_of(scene_of(rng, planes[0], 4, TURBULENT, True), 4, 12)
    whole, told = light.details(planes, 4, terms, 3)
    monkeypatch.setattr("gpu.evidence_groups.LARGEST_LAUNCH", 600 << 10)  # two poses
    monkeypatch.setattr("gpu.evidence_groups.LARGEST_MATRIX", 0)
    parts, again = light.details(planes, 4, terms, 3)
    np.testing.assert_array_equal(parts.log_evidence, whole.log_evidence)
    np.testing.assert_array_equal(parts.values, whole.values)
    for one, other in zip(told, again, strict=True):
        np.testing.assert_array_equal(one.normal, other.normal)
        np.testing.assert_array_equal(one.columns, other.columns)


def test_a_side_of_no_whole_lanes_is_refused(light):
    rng = np.random.default_rng(1)
    planes = wedges(rng, 40, 2, 0)
    terms = terms_of(scene_of(rng, planes, 2, SHARP, False), 2, 6)
    with pytest.raises(ValueError, match="40"):
        light.evidence(planes[None], 2, terms, 2)


def test_patches_that_are_kept_are_told_apart(light):
    rng = np.random.default_rng(9)
    planes = wedges(rng, 32, 3, 3)
    several = [terms_of(scene_of(rng, planes, 3, SHARP, True, stars=k % 3), 3, 10) for k in range(6)]
    several.append(replace(several[0], stars=np.zeros_like(several[0].stars), full=~several[0].full))
    there = [float(light.evidence(planes[None], 3, one, 3).log_evidence[0]) for one in several]
    back = [float(light.evidence(planes[None], 3, one, 3).log_evidence[0]) for one in several[::-1]]
    assert back[::-1] == there and len(set(there)) == len(several)
