"""The light of one pose against one patch: evidence against optimisation and sampling in plain NumPy, and its traps."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from lit_body import QUALITY, SUN, VIEW, lit_body, pose, scene, seen, shares
from scipy.ndimage import gaussian_filter
from scipy.optimize import minimize
from scipy.special import gammaln
from scipy.stats import multivariate_t

from service.inference.model import prior
from service.inference.model.likelihood import fit_light, t_log_density
from service.inference.model.scene import Scene
from service.inference.model.spread import PointSpread
from service.inference.model.terms import Terms, terms_of
from service.inference.pose import retract

SIZE, SIGMA, CORE, LOW_PASS = 32, 5.0, 1.4, 1.0
# two albedos, gain, even light, hidden, sky (3), tilt (3)
MEANS = np.array([0.0, 0.0, np.log(300.0), 0.15, 0.3, *np.zeros(6)])
DEVIATIONS = np.array([0.3, 0.3, 0.5, 0.05, 0.4, 4.0, 4.0, 4.0, 0.02, 0.02, 0.02])
HIDDEN, TILTED = 6.0, 350.0  # counts


def planes() -> np.ndarray:
    """(6, S, S): two groups beside each other, both under an even light, and their normals."""
    out = np.zeros((6, SIZE, SIZE), np.float32)
    out[0, 8:20, 6:16] = np.linspace(0.5, 1.0, 10)
    out[1, 12:25, 16:27] = 0.6
    out[2, 8:25, 6:27] = 1.0
    out[3, 8:25, 6:27], out[4, 8:25, 6:27] = np.linspace(-0.8, 0.4, 21), np.linspace(-0.3, 0.5, 17)[:, None]
    out[5] = -np.sqrt(1 - out[3] ** 2 - out[4] ** 2) * out[2]
    return out


@functools.cache
def blurred(sigma: float) -> np.ndarray:
    """(6, S, S)"""
    return np.stack([gaussian_filter(p.astype(float), sigma, mode="constant", truncate=6.0) for p in planes()])


def model(x: np.ndarray) -> np.ndarray:
    """(N, 11) unknowns -> (N, S, S) what the frame looks like after its low pass, in double precision."""
    slope = np.linspace(-1, 1, SIZE)
    sky = np.stack([np.ones((SIZE, SIZE)), np.tile(slope, (SIZE, 1)), np.tile(slope[:, None], (1, SIZE))])
    gain = np.exp(x[:, 2:3])
    weights = np.hstack([gain * np.exp(x[:, :2]), gain * x[:, 3:4] - HIDDEN * x[:, 4:5], TILTED * x[:, 8:]])
    return np.tensordot(weights, blurred(np.hypot(CORE, LOW_PASS)), 1) + np.tensordot(x[:, 5:8], sky, 1)


def log_joint(x: np.ndarray, data: np.ndarray, area: float) -> np.ndarray:
    """(N,) of section 3: Student t with four degrees of freedom, and the prior over its own height."""
    scale2 = SIGMA**2 / area
    density = gammaln(2.5) - gammaln(2.0) - 0.5 * np.log(4 * np.pi * scale2)
    density = density - 2.5 * np.log1p((data - model(x)) ** 2 / (4 * scale2))
    return density.sum(axis=(1, 2)) / area - 0.5 * np.sum(((x - MEANS) / DEVIATIONS) ** 2, axis=1)


def hessian(function, x: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """(D, D) by central differences."""
    d = len(x)
    out = np.empty((d, d))
    for i in range(d):
        for j in range(d):
            a, b = np.eye(d)[i] * steps, np.eye(d)[j] * steps
            corners = function(np.stack([x + a + b, x + a - b, x - a + b, x - a - b]))
            out[i, j] = (corners[0] - corners[1] - corners[2] + corners[3]) / (4 * steps[i] * steps[j])
    return out


def told(noise: float, off: float = 0.7, shares: tuple[float, float] | None = None) -> tuple[Terms, np.ndarray, float]:
    """What the likelihood is told of a frame with this share of the noise that it believes in; frame and area.

    ``off``: how far from their means the unknowns are, in their deviations; ``shares``: even light and hidden sky.
    """
    rng = np.random.default_rng(4)
    truth = MEANS + off * DEVIATIONS * np.array([1, -1, 0.5, 0.4, 1, -1, 0.5, 1, 1, -1, 0.5])
    truth[3:5] = truth[3:5] if shares is None else shares
    gain = np.exp(truth[2])
    weights = [*gain * np.exp(truth[:2]), gain * truth[3] - HIDDEN * truth[4], *TILTED * truth[8:]]
    image = np.tensordot(weights, blurred(CORE), 1) + truth[5]
    image = image + noise * SIGMA * rng.normal(size=image.shape)
    none = np.zeros(image.shape, bool)
    given = Scene(image.astype(np.float32), SIGMA, 0.0, HIDDEN, none, PointSpread(CORE), 0.0, False, LOW_PASS)
    terms = terms_of(given, 2, 6)
    terms = replace(terms, mean=MEANS.astype(np.float32), precision=(DEVIATIONS**-2).astype(np.float32))
    terms = replace(terms, gain=float(np.log(TILTED)))
    return terms, gaussian_filter(image, LOW_PASS, mode="constant", truncate=6.0), 4 * np.pi * LOW_PASS**2


def laplace(data: np.ndarray, area: float) -> tuple[float, np.ndarray, np.ndarray]:
    """Log evidence, where the maximum is, and the precision there."""
    step = 1e-4 * np.eye(11)

    def cost(z: np.ndarray) -> np.ndarray:
        return -log_joint(MEANS + DEVIATIONS * np.atleast_2d(z), data, area)

    found = minimize(
        lambda z: cost(z)[0], np.zeros(11), jac=lambda z: (cost(z + step) - cost(z - step)) / 2e-4, tol=1e-6
    )
    best = MEANS + DEVIATIONS * found.x
    curvature = -hessian(lambda x: log_joint(x, data, area), best, 1e-3 * DEVIATIONS)
    logdet = np.linalg.slogdet(curvature * np.outer(DEVIATIONS, DEVIATIONS))[1]
    return -found.fun - 0.5 * logdet, best, curvature


def light_evidence(terms: Terms, rounds: int = 12) -> dict[str, float]:
    """By both twins."""
    device = lit_body().light.evidence(planes()[None], 2, terms, rounds)
    return {"numpy": fit_light(planes(), 2, terms, rounds).log_evidence, "opencl": float(device.log_evidence[0])}


def test_without_noise_the_evidence_is_laplaces_and_the_light_the_most_probable():
    terms, data, area = told(noise=0.0, off=0.1)
    assert terms.area == pytest.approx(area, rel=1e-3)
    wanted, best, curvature = laplace(data, area)
    for name, found in light_evidence(terms).items():
        assert found == pytest.approx(wanted, abs=0.05), name
    fit = fit_light(planes(), 2, terms, 12)
    assert fit.deviation + MEANS == pytest.approx(best, abs=0.06 * np.sqrt(np.diag(np.linalg.inv(curvature))).min())
    gain = np.exp(best[2])
    drawn = [*gain * np.exp(best[:2]), gain * best[3] - HIDDEN * best[4], *TILTED * best[8:]]
    assert fit.coefficients == pytest.approx(np.array(drawn), rel=0.01, abs=0.05)


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_the_evidence_is_the_integral_over_all_unknowns(noise):
    """By importance sampling. With noise the weights' curvature is a little larger than the Student t's own."""
    terms, data, area = told(noise)
    _, best, curvature = laplace(data, area)
    proposal = multivariate_t(best, np.linalg.inv(curvature), df=8, seed=1)
    x = proposal.rvs(4000)
    log_weights = log_joint(x, data, area) - proposal.logpdf(x)
    prior_height = -np.sum(np.log(DEVIATIONS)) - 5.5 * np.log(2 * np.pi)
    wanted = prior_height + log_weights.max() + np.log(np.mean(np.exp(log_weights - log_weights.max())))
    for name, found in light_evidence(terms).items():
        assert wanted - 0.15 * len(MEANS) * noise - 0.1 < found < wanted + 0.1, name


@pytest.mark.parametrize("shares", [(-0.4, 0.3), (0.05, -0.8), (0.05, 1.5)])
def test_no_body_brightens_the_sky_and_none_hides_more_than_there_is(shares, monkeypatch):
    """Wherever the frame pulls them, shares stay in their range, all else at its best there."""
    monkeypatch.setitem(globals(), "HIDDEN", 60.0)
    terms, data, area = told(noise=0.0, off=0.1, shares=shares)
    ranges = [(None, None)] * 11
    ranges[3], ranges[4] = (
        (-MEANS[3] / DEVIATIONS[3], None),
        (-MEANS[4] / DEVIATIONS[4], (1 - MEANS[4]) / DEVIATIONS[4]),
    )
    step = 1e-4 * np.eye(11)

    def cost(z: np.ndarray) -> np.ndarray:
        return -log_joint(MEANS + DEVIATIONS * np.atleast_2d(z), data, area)

    def slope(z: np.ndarray) -> np.ndarray:
        return (cost(z + step) - cost(z - step)) / 2e-4

    found = minimize(lambda z: cost(z)[0], np.zeros(11), jac=slope, bounds=ranges, tol=1e-9)
    device, (details,) = lit_body().light.details(planes()[None], 2, terms, 60)
    fit = fit_light(planes(), 2, terms, 60)
    for values in (fit.values, device.values[0]):
        assert -log_joint(values[None].astype(float), data, area)[0] < found.fun + 0.05
        assert values[3] >= 0.0 and 0.0 <= values[4] <= 1.0
    held = np.isclose(fit.values[3:5], np.round(fit.values[3:5]), rtol=0, atol=1e-5)
    assert held.any()
    for one in (fit, details):
        assert (np.diag(one.normal)[3:5][held] > 1e6 / DEVIATIONS[3:5][held] ** 2).all()


def test_what_is_known_of_albedos_is_their_prior_in_both_twins():
    """As the posterior of the last frame is the prior of the next."""
    terms, *_ = told(noise=0.5)
    mean = terms.mean.copy()
    mean[:2] = 0.5, -0.4
    found = light_evidence(replace(terms, mean=mean))
    assert found["opencl"] == pytest.approx(found["numpy"], abs=0.02)


def test_student_t_is_a_density():
    at = np.linspace(-400, 400, 40_001)
    total = np.exp(t_log_density(at, np.full_like(at, 2.5)).astype(float)).sum() * (at[1] - at[0])
    assert total == pytest.approx(1.0, abs=1e-3)


def body_evidence(given: Scene, turns: np.ndarray) -> np.ndarray:
    """(N,) of the small body, moved from ``pose()`` by tangent steps (N, 7)."""
    drawing, start = lit_body(), pose()
    moved = retract(start[np.zeros(len(turns), int)], turns)
    drawn = drawing.planes(moved, SUN, VIEW, QUALITY)
    return drawing.light.evidence(
        drawn, drawing.n_groups, terms_of(given, drawing.n_groups, drawn.shape[1]), 8
    ).log_evidence


@pytest.mark.parametrize("discrepancy", [1e-3, 0.05, 0.5])
@pytest.mark.parametrize("gain", [60.0, 2000.0])
def test_a_pose_that_explains_nothing_loses(gain, discrepancy):
    """It could win if the discrepancy were a share of the data."""
    image = seen(pose(), shares(lit_body(), gain)) + np.random.default_rng(2).normal(0, 4.0, (VIEW.side,) * 2)
    away = np.zeros((4, 7))
    away[1, 3:5] = 500.0  # nothing in the patch
    away[2, 3:5] = 25.0  # beside it
    away[3, 5] = -2.0  # a dot in its middle
    found = body_evidence(scene(image, 4.0, discrepancy=discrepancy, sky=3.0), away)
    assert np.isfinite(found).all()
    assert (found[1:] < found[0] - 10.0).all()


def test_one_low_pass_for_all_point_spreads_compares_the_same_data():
    """The truth's point spread wins; where each has a low pass of its own, the frames that are compared differ."""
    image = seen(pose(), shares(lit_body(), 900.0), core=1.6) + np.random.default_rng(3).normal(0, 4, (VIEW.side,) * 2)
    cores = (1.0, 1.3, 1.6, 2.0, 2.6)
    scenes = [scene(image, 4.0, core=core, low_pass=1.0) for core in cores]
    assert all(np.array_equal(one.data, scenes[0].data) and one.area == scenes[0].area for one in scenes)
    found = [body_evidence(one, np.zeros((1, 7)))[0] for one in scenes]
    assert cores[int(np.argmax(found))] == 1.6
    own = [scene(image, 4.0, core=core) for core in cores]
    assert [one.smoothing for one in own] == sorted({one.smoothing for one in own})


def test_the_pose_does_not_choose_what_it_is_compared_with():
    """Neither data nor area nor prior follow the drawn planes."""
    given = scene(seen(pose(), shares(lit_body(), 900.0)), 4.0)
    one, other = terms_of(given, 3, 10), terms_of(given, 3, 10)
    assert one.data is other.data
    assert (one.area, one.noise, one.wrong) == (other.area, other.noise, other.wrong)


def test_a_plane_without_light_is_left_out_and_keeps_its_prior_brightness():
    terms, *_ = told(noise=1.0)
    dark = planes()
    dark[1] = 0.0
    fit = fit_light(dark, 2, terms)
    assert len(fit.columns) == len(fit.precision) == len(fit.deviation) == len(MEANS) - 1
    gain = np.exp(fit.deviation[1] + MEANS[2])
    assert fit.coefficients[1] == pytest.approx(gain, rel=1e-4)
    device = lit_body().light.evidence(dark[None], 2, terms, 6)
    assert device.log_evidence[0] == pytest.approx(fit.log_evidence, abs=0.02)
    assert device.coefficients[0] == pytest.approx(fit.coefficients, rel=1e-3, abs=1e-2)


def test_even_light_from_one_side_is_found_and_a_frame_without_it_has_none():
    """As the Earth's: without it the body's dark side would be another body's."""
    drawn = lit_body().planes(pose(), SUN, VIEW, QUALITY)
    for tilt in ((0.02, -0.03, 0.0), (0.0, 0.0, 0.0)):
        even = (0.06, *tilt)
        image = seen(pose(), shares(lit_body(), 900.0, even=even)) + np.random.default_rng(1).normal(0, 4, (64, 64))
        terms = terms_of(scene(image, 4.0), 3, 10)
        fit = fit_light(drawn[0], 3, terms)
        assert fit.coefficients[4:6] / 900.0 == pytest.approx(tilt[:2], abs=0.008)
        none = replace(terms, precision=np.where(np.arange(len(terms.mean)) // 3 == 4, 1e12, terms.precision))
        assert (fit.log_evidence - fit_light(drawn[0], 3, none).log_evidence > 5.0) == any(tilt)


@pytest.mark.parametrize("wings", [0.0, 1.2])
def test_speckle_and_shifts_are_unknowns_only_where_there_is_air(wings):
    image = seen(pose(), shares(lit_body(), 900.0), wings=wings) + np.random.default_rng(3).normal(
        0, 4, (VIEW.side,) * 2
    )
    given = scene(image, 4.0, wings=wings, shifts=True, discrepancy=0.04)
    drawn = lit_body().planes(pose(), SUN, VIEW, QUALITY)
    terms = terms_of(given, 3, 10)
    fit = fit_light(drawn[0], 3, terms)
    assert len(terms.mean) == 6 + 9 + 12 + (18 if wings else 0)
    device = lit_body().light.evidence(drawn, 3, terms, 6)
    assert device.log_evidence[0] == pytest.approx(fit.log_evidence, abs=0.05)
    assert np.abs(fit.deviation * np.sqrt(fit.precision))[-12:].max() < 3.0


def starry_scene(counts: float, *, told: bool) -> Scene:
    """The small body, and beside it a star of so many counts; ``told``: its pixels may be one's."""
    image = seen(pose(), shares(lit_body(), 900.0)) + np.random.default_rng(2).normal(0, 4.0, (VIEW.side,) * 2)
    image[50:53, 50:53] += counts
    starry = np.zeros(image.shape, np.uint8)
    starry[49:54, 49:54] = told
    return scene(image, 4.0, low_pass=1.0, starry=starry)


def test_a_star_beside_the_body_costs_its_price_and_no_more():
    still = np.zeros((1, 7))
    alone, among, unknown = (
        float(body_evidence(starry_scene(counts, told=told), still)[0])
        for counts, told in ((0.0, True), (400.0, True), (400.0, False))
    )
    assert -prior.STAR - 1.0 < among - alone < -prior.STAR + 5.0  # noise that is bright there is forgiven too
    assert unknown < among - 10.0


def test_a_star_does_not_pull_the_pose_that_would_cover_it():
    """A body that reaches for a star's light wins only where that light is no star's."""
    turns = np.zeros((2, 7))
    turns[1, 3:5] = 12.0  # its rim over the star, the true body's own light left over
    for told in (True, False):
        found = body_evidence(starry_scene(400.0, told=told), turns)
        assert found[0] > found[1] + 10.0
    with_star, without = (body_evidence(starry_scene(400.0, told=told), turns) for told in (True, False))
    assert with_star[0] - with_star[1] > without[0] - without[1]
