"""At least half of the body in the image: of what is drawn from the paper's prior, and of what is moved."""

import numpy as np
import pytest

from gpu.mesh import assemble
from gpu.raw_part import RawPart
from gpu.reference import silhouette_mask
from gpu.scorer import open_scorer
from service.inference.articulation import Articulation, Joint, Stage, part_transforms
from service.inference.domain import Domain, sample_prior
from service.inference.params import FilterParams, MotionParams, PriorParams, SessionConfig
from service.inference.state import FilterState, Frame, Measurement, Poses
from service.inference.step import bootstrap_update
from service.workers.scoring import TimedScorer
from service.workers.visible import HalfShown

HEIGHT, WIDTH, MARGIN = 36, 48, 48
COUNT = 150
BOOM = Joint("boom", "prismatic", 0, 1.5, 0, (Stage("prismatic", ("tip",), (1, 0, 0)),))
ARTICULATION = Articulation(("bus", "tip"), (BOOM,))


def box(name, size, at):
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size + at
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return RawPart(name, corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]))


@pytest.fixture(scope="module")
def mesh():
    """Lopsided: a box, and a small one on a boom that slides out of the radius at rest."""
    return assemble([box("bus", (0.8, 0.6, 0.4), (0, 0, 0)), box("tip", (0.3, 0.1, 0.1), (1.1, 0, 0))])


@pytest.fixture(scope="module")
def shows_half(mesh):
    scorer = open_scorer(mesh, backend="reference")
    return HalfShown(TimedScorer(scorer, ARTICULATION, np.zeros((HEIGHT, WIDTH))), mesh, (HEIGHT, WIDTH))


@pytest.fixture(scope="module")
def domain(mesh, shows_half):
    return Domain(WIDTH, HEIGHT, mesh.radius, ARTICULATION, PriorParams(), None, shows_half)


def share_in_image(mesh, poses: Poses) -> np.ndarray:
    """(N,) of each silhouette's pixels, counted on a canvas that holds all of it."""
    shares = []
    for transforms in part_transforms(ARTICULATION, poses):
        shifted = transforms.copy()
        shifted[:, :2, 3] += MARGIN
        mask = silhouette_mask(mesh, shifted, (HEIGHT + 2 * MARGIN, WIDTH + 2 * MARGIN))
        shares.append(mask[MARGIN:-MARGIN, MARGIN:-MARGIN].sum() / mask.sum())
    return np.array(shares)


def test_the_prior_shows_half_of_every_body(mesh, domain):
    drawn = sample_prior(np.random.default_rng(1), domain, COUNT)
    centred = Domain(WIDTH, HEIGHT, mesh.radius, ARTICULATION, PriorParams())  # as by its centre alone
    by_centre = sample_prior(np.random.default_rng(1), centred, COUNT)
    rounding = 0.06  # the whole is counted on other pixels: a body of 4 px has few
    assert len(drawn) == COUNT and domain.contains(drawn).all()
    assert share_in_image(mesh, drawn).min() > 0.5 - rounding
    assert np.mean(share_in_image(mesh, by_centre) < 0.5 - rounding) > 0.03
    assert not centred.contains(drawn).all()  # half of a lopsided body, its centre outside


def test_what_the_rule_says_is_what_is_seen(mesh, shows_half):
    everywhere = Domain(WIDTH, HEIGHT, mesh.radius, ARTICULATION, PriorParams(), None, lambda p: np.ones(len(p), bool))
    drawn = sample_prior(np.random.default_rng(2), everywhere, COUNT)
    share = share_in_image(mesh, drawn)
    clear = np.abs(share - 0.5) > 0.06
    assert clear.sum() > 100 and 0.1 < np.mean(share > 0.5) < 0.8
    np.testing.assert_array_equal(shows_half(drawn)[clear], share[clear] > 0.5)
    assert shows_half(drawn[slice(0)]).shape == (0,)


def test_no_jitter_leaves_it(domain, shows_half):
    wild = SessionConfig(
        filter=FilterParams("paper", "bootstrap", COUNT, 3, "multinomial"),
        motion=MotionParams("jitter", rotation_deg=90, position=0.5, log_scale=0.3),
    )
    state, frame = None, Measurement(np.zeros((HEIGHT, WIDTH), np.float32), 0.0)
    for index in range(3):
        rng = np.random.default_rng(index)
        found = bootstrap_update(
            rng, state, Frame(index, float(index), frame), lambda p: np.zeros(len(p)), wild, domain
        )
        assert shows_half(found.poses).all()
        state = FilterState(found.poses, found.log_weights, found.rates, index, float(index), found.status)


def test_a_body_too_large_to_be_shown_by_half_is_drawn_and_moved_within_the_bounds(mesh, shows_half):
    vast = Domain(WIDTH, HEIGHT, mesh.radius, ARTICULATION, PriorParams(), (200.0, 300.0), shows_half)
    drawn = sample_prior(np.random.default_rng(3), vast, 5)
    assert len(drawn) == 5 and vast.contains(drawn).all()
    assert vast.stays(drawn, drawn).all()
