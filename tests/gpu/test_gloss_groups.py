"""Surface groups of which several have one gloss."""

import numpy as np
import pytest
from gpu_cases import box, mesh_of
from test_shaded import AROUND, BODIES, FORMS, GLOSS, SIZES, suns, views

from gpu.shaded import open_shaded
from gpu.shaded_reference import EVEN_PLANES, Drawing, reference_planes
from gpu.surface_groups import gloss_groups, surface_groups


@pytest.mark.parametrize("name", BODIES)
@pytest.mark.parametrize(("kind", "together"), FORMS)
def test_they_show_the_sum_of_theirs(name, kind, together):
    mesh = BODIES[name]
    groups, given, sun = surface_groups(mesh), views(mesh, 5, 40), suns(np.random.default_rng(9), 5)
    shine = np.minimum(np.arange(groups.max() + 1), 1)
    apart, body = (open_shaded(mesh, groups, one, kind=kind, together=together) for one in (None, shine))
    light = {**SIZES, "gloss": GLOSS, "around": AROUND}
    planes, each, first = body.planes(given, sun, **light), apart.planes(given, sun, **light), len(shine) + EVEN_PLANES
    assert planes[:, :first] == pytest.approx(each[:, :first])
    lobes = each[:, first:].reshape(5, len(GLOSS), len(shine), 40, 40)
    both = np.stack([lobes[:, :, shine == k].sum(axis=2) for k in range(body.n_shiny)], axis=2)
    assert planes[:, first:] == pytest.approx(both.reshape(5, -1, 40, 40), abs=1e-5)
    wanted = reference_planes(mesh, groups, given, sun, Drawing(*SIZES.values(), GLOSS, around=AROUND), shine)
    assert np.abs(planes - wanted).sum() < 2e-3 * np.abs(wanted).sum()
    weights = np.random.default_rng(7).uniform(-1, 1, (5, planes.shape[1]))
    assert body.combined(given, sun, weights, **light) == pytest.approx(
        np.einsum("nk,nkij->nij", weights, planes), abs=2e-5
    )
    apart.close()
    body.close()


def test_of_many_pieces_the_large_have_gloss_of_their_own_and_the_small_share_one():
    large = [box((4.0 - k,) * 3, (9.0 * k, 0, 0)) for k in range(3)]
    mesh = mesh_of(*large, *[box((0.1,) * 3, (k, 9, 9)) for k in (1, 2)])
    assert gloss_groups(mesh, surface_groups(mesh)).tolist() == [0, 1, 2, 3, 3]
    assert gloss_groups(mesh_of(box((1.0, 2.0, 3.0))), np.zeros(12, np.int32)).tolist() == [0]
