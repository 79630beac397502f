"""The start from nothing: evidence, joints that cover their ranges, rotations placed onto the light."""

import numpy as np
import pytest

from service.inference.acquisition import draw_joints, find_evidence, place
from service.inference.articulation import Articulation, Joint, Stage
from service.inference.domain import Domain
from service.inference.params import PriorParams

EMPTY = np.full((40, 50), -1.0, np.float32)


def jointed(n: int) -> Domain:
    joints = tuple(
        Joint(f"j{k}", "revolute", -10.0 * k, 90.0, 0.0, (Stage("revolute", ("bus",), (0, 0, 1)),)) for k in range(n)
    )
    return Domain(64, 48, 1.2, Articulation(("bus",), joints), PriorParams())


def philox(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(seed))


def test_evidence_by_hand():
    """A bar of 10 x 4 pixels from (20, 8): centroid (25, 10), variance (99 + 15) / 12."""
    light = EMPTY.copy()
    light[8:12, 20:30] = 1.0
    found = find_evidence(light)
    assert found.area_px == 40
    np.testing.assert_allclose(found.centroid, [25, 10])
    assert found.radius_px == pytest.approx(np.sqrt((99 + 15) / 12))


def test_specks_are_no_evidence_beside_a_body():
    light = EMPTY.copy()
    light[8:18, 20:30] = 1.0
    light[35, 45] = light[2, 2] = 3.0
    np.testing.assert_allclose(find_evidence(light).centroid, [25, 13])
    assert find_evidence(EMPTY) is None


@pytest.mark.parametrize("n", [0, 1, 2, 3, 5])
def test_joints_cover_their_ranges_and_one_another(n):
    """In every pair of joints none of 10 x 10 cells is empty or holds twice its share of 4000 draws."""
    domain = jointed(n)
    joints = draw_joints(philox(1), domain, 4000)
    assert joints.shape == (4000, n)
    least, greatest = domain.joint_bounds
    unit = (joints - least) / (greatest - least)
    assert np.all((unit >= 0) & (unit < 1))
    for a in range(n):
        for b in range(a):
            cells, _, _ = np.histogram2d(unit[:, a], unit[:, b], 10, [[0, 1], [0, 1]])
            assert np.all(np.abs(cells - 40) < 40)


def test_starts_have_the_area_and_the_centroid_of_the_light(block, rigid, quick_score_maps):
    domain = Domain(64, 48, block.radius, rigid, PriorParams(0.1, 1.0))
    light = np.full((48, 64), -1.0, np.float32)
    light[10:30, 20:44] = 2.0
    evidence = find_evidence(light)
    poses = place(philox(2), domain, evidence, quick_score_maps, 300)
    assert domain.contains(poses).all()
    y, x = np.mgrid[:48, :64] + 0.5
    maps = np.stack([np.ones((48, 64)), x, y]).astype(np.float32)
    sums = quick_score_maps(poses, maps)
    np.testing.assert_allclose(np.median(sums[:, 1:] / sums[:, :1], axis=0), [32, 20], atol=0.5)
    assert np.median(sums[:, 0]) == pytest.approx(evidence.area_px, rel=0.1)
    spread = np.std(0.5 * np.log(sums[:, 0] / evidence.area_px))
    assert 0.05 < spread < 0.2  # parts may be unlit: scales are strewn about the light's
