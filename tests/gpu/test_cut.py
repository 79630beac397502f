"""What is left out of a patch is dark: pictures and evidence are those of the whole."""

import numpy as np
import pytest
from gpu_cases import box, mesh_of, transforms

from gpu.cut import cut_of, window_around
from gpu.shaded import open_shaded
from gpu.shaded_faces import part_box
from gpu.surface_groups import surface_groups

PANEL = mesh_of(box((1.0, 1.0, 1.0)), box((0.02, 3.0, 1.2), (0.0, 2.2, 0.0)))
SIDE = 96


def poses(n: int, radius: float, middle: tuple[float, float], seed: int = 3) -> np.ndarray:
    given = transforms(np.random.default_rng(seed), PANEL, n, radius, (SIDE, SIDE), 0.0)
    given[:, :, :2, 3] += np.array(middle) - SIDE / 2
    return given


@pytest.mark.parametrize("middle", [(48.0, 48.0), (10.0, 80.0), (-30.0, 48.0), (300.0, -200.0)])
def test_a_cut_holds_all_that_is_drawn(middle):
    with_cut, without = (open_shaded(PANEL, surface_groups(PANEL), kind="cpu") for _ in range(2))
    given, sun = poses(6, 22.0, middle), np.array([0.3, -0.4, -0.8])
    how = {"side": SIDE, "supersample": 4, "shadow_px": 128, "gloss": (20.0,)}
    cut = with_cut.cut(given, sun, **how)
    whole = without.planes(given, sun, **how, lens=(1e9, 48.0, 48.0))  # through a lens nothing is left out
    assert cut.whole() == pytest.approx(whole, abs=1e-4)
    assert cut.values.size < whole.size
    assert np.array_equal(cut.whole()[2:4], cut[2:4].whole())


def test_a_small_body_is_kept_on_a_small_part_of_its_patch():
    body = open_shaded(PANEL, surface_groups(PANEL), kind="cpu")
    cut = body.cut(poses(1, 12.0, (48.0, 48.0)), np.array([0.0, 0.0, -1.0]), side=SIDE, supersample=2, shadow_px=64)
    assert cut.values.size < 0.3 * cut.whole().size
    assert cut.left % 16 == cut.values.shape[3] % 16 == 0


@pytest.mark.parametrize("side", [7, 16, 40, 96])
def test_a_window_lies_in_its_patch_and_is_never_empty(side):
    rng = np.random.default_rng(side)
    boxes = np.stack([part_box(part.vertices) for part in PANEL.parts])
    for _ in range(50):
        given = rng.normal(0, 10.0 ** rng.uniform(-3, 3), (3, len(boxes), 3, 4)).astype(np.float32)
        seen = window_around(given, boxes, side)
        assert 0 <= seen.top < seen.top + seen.rows <= side
        assert 0 <= seen.left < seen.left + seen.columns <= side
        assert seen.left % 16 == 0


def test_an_array_that_is_smaller_than_its_patch_is_its_corner():
    corner = cut_of(np.ones((1, 2, 1, 16), np.float32), 32)
    assert corner.whole().shape == (1, 2, 32, 32)
    assert corner.whole()[0, 1].sum() == corner.whole()[0, 1, 0, :16].sum() == 16
    assert cut_of(corner, 32) is corner
