"""Equation 4 as the service computes it, against the direct product over the pixels of the paper's distributions."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gpu.reference import silhouette_mask
from service.imaging.background import FLOOR, learn
from service.imaging.features import feature_spec
from service.imaging.measurement import measure
from service.imaging.sky import derive
from service.inference.articulation import part_transforms
from service.inference.pose import exp_so3
from service.inference.state import Poses


def histogram_maps(background: np.ndarray, image: np.ndarray, bits: int):
    spec = feature_spec("intensity", 1, bits, 1.0)
    sky = derive(learn(None, background, bits, spec, np.ones(background.shape, bool)), "intensity", 1.0)
    return measure(image, sky)


def direct_log_likelihood(background: np.ndarray, image: np.ndarray, bits: int, silhouette: np.ndarray) -> float:
    """The log of Eq. 1, pixel by pixel: p(D|f) inside and p(D|b) outside, divided by p(D)."""
    levels = 2**bits
    terms = []
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            value = image[row, column]
            p_total = np.count_nonzero(image == value) / image.size
            p_background = (1 - FLOOR) * np.count_nonzero(background == value) / background.size + FLOOR / levels
            p_foreground = 1 / levels
            terms.append(math.log((p_foreground if silhouette[row, column] else p_background) / p_total))
    return math.fsum(terms)


def test_equation_4_by_hand():
    """Four levels, silhouette over the pixels of level 3 and one of level 0.

    p(D|b) = 0.7495, 0.25, 0.00025, 0.00025; p(D|f) = 1/4; p(D) = 1/3, 1/6, 0, 1/2. Inside: three of level 3,
    (0.25 / 0.5)^3, one of level 0, 0.25 / (1/3). Outside: level 0, 0.7495 / (1/3), level 1, 0.25 / (1/6).
    """
    background = np.array([[0, 0, 0, 1], [0, 0, 1, 0]], np.uint8)
    image = np.array([[0, 3, 3], [0, 3, 1]], np.uint8)
    silhouette = np.array([[1, 1, 1], [0, 1, 0]], bool)
    by_hand = 3 * math.log(0.5) + math.log(0.75) + math.log(2.2485) + math.log(1.5)
    assert by_hand == pytest.approx(-1.1514, abs=1e-4)
    log_ratio, constant = histogram_maps(background, image, 2)
    assert constant + log_ratio[silhouette].sum() == pytest.approx(by_hand, abs=1e-5)
    assert direct_log_likelihood(background, image, 2, silhouette) == pytest.approx(by_hand, abs=1e-12)


images = arrays(np.uint8, (7, 9), elements=st.integers(0, 15))


@settings(max_examples=60)
@given(images, images, arrays(np.bool_, (7, 9)))
def test_constant_and_particle_term_are_the_direct_product(background, image, silhouette):
    """Any images, any silhouette: the empty one (all background) and the full one too."""
    log_ratio, constant = histogram_maps(background, image, 4)
    for mask in (silhouette, np.zeros_like(silhouette), np.ones_like(silhouette)):
        found = constant + float(log_ratio[mask].astype(np.float64).sum())
        assert found == pytest.approx(direct_log_likelihood(background, image, 4, mask), abs=1e-4)


def test_the_score_of_a_pose_is_the_product_under_its_silhouette(block, rigid, score_of):
    """From pose to likelihood: project, cover, sum; against the product with the silhouette's own mask."""
    rng = np.random.default_rng(1)
    background = rng.integers(0, 8, (24, 32)).astype(np.uint8)
    image = rng.integers(0, 16, (24, 32)).astype(np.uint8)
    poses = Poses(
        exp_so3(rng.standard_normal((6, 3))),
        rng.uniform(4, 24, (6, 2)),
        np.log(rng.uniform(3, 12, 6)),
        np.zeros((6, 0)),
    )
    log_ratio, constant = histogram_maps(background, image, 4)
    scores = score_of(log_ratio)(poses) + constant
    for transforms, score in zip(part_transforms(rigid, poses), scores, strict=True):
        mask = silhouette_mask(block, transforms, image.shape)
        assert 4 < mask.sum() < 400
        assert score == pytest.approx(direct_log_likelihood(background, image, 4, mask), abs=1e-3)


def test_the_silhouette_of_an_upright_block_by_hand(block, rigid):
    """2 x 1.2 units at 10 px per unit about (16, 12): columns 6 to 25, rows 6 to 17."""
    pose = Poses(np.array([[1.0, 0, 0, 0]]), np.array([[16.0, 12.0]]), np.log([10.0]), np.zeros((1, 0)))
    mask = silhouette_mask(block, part_transforms(rigid, pose)[0], (24, 32))
    rows, columns = np.nonzero(mask)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (6, 17, 6, 25)
    assert mask.sum() == 12 * 20
