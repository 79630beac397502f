"""Sunlit bodies with cast shadows: against the twin in NumPy, against ray casting, and what must hold anyway."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from gpu_cases import box, mesh_of, shared_mesh, soup, sphere, transforms

from gpu.device import find_devices
from gpu.errors import DeviceError
from gpu.mesh import Mesh
from gpu.shaded import ShadedBody, open_shaded
from gpu.shaded_reference import EVEN_PLANES, Drawing, reference_planes
from gpu.surface_groups import surface_groups

# A GPU's form runs on a CPU, too, but for PoCL 5, which aborts while it compiles it (createParallelRegionBefore).
USABLE = {report.kind: report.driver for report in find_devices() if report.rejected is None}
FORMS = [(kind, None) for kind in sorted(USABLE)] + [("cpu", True)] * (USABLE.get("cpu", "5.")[:2] != "5.")
SIZES = {"side": 40, "supersample": 3, "shadow_px": 128}
GLOSS = (8.0, 40.0)
AROUND = (0.05, -0.1, 0.08, 0.06)  # some faces have none of it
PANEL = mesh_of(box((1.0, 1.0, 1.0)), box((0.02, 3.0, 1.2), (0.0, 2.2, 0.0)), box((2.0, 0.1, 0.1), (1.2, 0.0, 0.2)))
BODIES = {
    "panel": PANEL,
    "sphere": mesh_of(sphere(10)),
    "soup": mesh_of(soup(np.random.default_rng(5), 60, 40)),
    "one triangle": mesh_of((np.array([[0, 0, 0], [1, 0, 0.2], [0, 1, -0.3]]), np.array([[0, 1, 2]]))),
}


@pytest.fixture(params=FORMS, ids=["groups" if together else kind for kind, together in FORMS])
def open_body(request, monkeypatch) -> Callable[..., ShadedBody]:
    kind, together = request.param
    if together:  # many rounds and tiles
        monkeypatch.setattr("gpu.shaded_forms.GROUP", 24)
        monkeypatch.setattr("gpu.shaded_forms.TILE", 1000)
    return partial(open_shaded, kind=kind, together=together)


def suns(rng: np.random.Generator, n: int) -> np.ndarray:
    found = rng.normal(size=(n, 3))
    found[:, 2] = -np.abs(found[:, 2]) + 0.3
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def views(mesh: Mesh, n: int, side: int, seed: int = 1, radius: float = 0.45) -> np.ndarray:
    return transforms(np.random.default_rng(seed), mesh, n, radius * side, (side, side), 0.05 * side)


def differing(found: np.ndarray, wanted: np.ndarray, covered: np.ndarray) -> float:
    """Share of the covered pixels in which some plane is another by a hundredth."""
    return float((np.abs(found - wanted).max(axis=1) > 0.01)[covered].mean())


@pytest.mark.parametrize("name", BODIES)
@pytest.mark.parametrize(("side", "supersample", "shadow_px"), [(40, 3, 128), (33, 1, 70), (20, 4, 0), (7, 2, 17)])
def test_planes_are_the_twins_but_for_samples_at_edges(name, side, supersample, shadow_px, open_body):
    mesh = BODIES[name]
    groups, given, sun = surface_groups(mesh), views(mesh, 8, side), suns(np.random.default_rng(2), 8)
    body = open_body(mesh, groups, drop_hidden=False)
    sizes = {"side": side, "supersample": supersample, "shadow_px": shadow_px}
    found = body.planes(given, sun, **sizes, gloss=GLOSS, around=AROUND)
    wanted = reference_planes(mesh, groups, given, sun, Drawing(*sizes.values(), GLOSS, around=AROUND))
    covered = wanted[:, body.n_groups] > 0
    assert covered.sum() > 8
    assert found.shape == wanted.shape
    assert differing(found, wanted, covered) < 0.01
    assert np.abs(found - wanted).sum() < 2e-3 * np.abs(wanted).sum()
    body.close()


@pytest.mark.parametrize("name", BODIES)
@pytest.mark.parametrize("lens", [(90.0, 20.0, 20.0), (60.0, -15.0, 31.5)])
def test_a_lens_shows_what_the_twin_does(name, lens, open_body):
    mesh = BODIES[name]
    groups, given, sun = surface_groups(mesh), views(mesh, 8, 40), suns(np.random.default_rng(2), 8)
    body = open_body(mesh, groups, drop_hidden=False)
    found = body.planes(given, sun, **SIZES, gloss=GLOSS, lens=lens)
    wanted = reference_planes(mesh, groups, given, sun, Drawing(*SIZES.values(), GLOSS, lens))
    covered = wanted[:, body.n_groups] > 0
    assert covered.sum() > 8
    assert differing(found, wanted, covered) < 0.01
    assert np.abs(found - wanted).sum() < 2e-3 * np.abs(wanted).sum()
    assert np.abs(found - body.planes(given, sun, **SIZES, gloss=GLOSS)).sum() > 0.05 * wanted.sum()  # not as if far
    body.close()


def test_from_far_away_a_lens_changes_nothing(open_body):
    groups, given, sun = surface_groups(PANEL), views(PANEL, 4, 40), suns(np.random.default_rng(2), 4)
    body = open_body(PANEL, groups)
    near, far = (body.planes(given, sun, **SIZES, lens=(focal, 20.0, 20.0)) for focal in (1e6, np.inf))
    assert differing(near, far, far[:, body.n_groups] > 0) < 0.01
    body.close()


@pytest.mark.parametrize("name", ["hubble", "iss", "suomi_npp", "tdrs"])
def test_real_bodies_agree_with_the_twin_though_hidden_faces_are_left_out(shared, name, open_body):
    mesh = shared_mesh(shared / "data" / "meshes" / f"{name}.glb")
    groups, given, sun = surface_groups(mesh), views(mesh, 3, 40), suns(np.random.default_rng(3), 3)
    body = open_body(mesh, groups)
    found = body.planes(given, sun, **SIZES)
    wanted = reference_planes(mesh, groups, given, sun, Drawing(*SIZES.values()))
    assert differing(found, wanted, wanted[:, body.n_groups] > 0) < 0.01
    body.close()


def rays_blocked(points: np.ndarray, towards: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(N,) whether a triangle of (F, 3, 3) lies between each of (N, 3) points and the Sun (Moeller and Trumbore)."""
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(towards, two)
    det = np.einsum("fk,fk->f", one, p)
    flat = np.abs(det) < 1e-12
    inverse = 1.0 / np.where(flat, 1.0, det)
    away = points[:, None] - corners[None, :, 0]
    u = np.einsum("nfk,fk->nf", away, p) * inverse
    q = np.cross(away, one[None])
    v = (q @ towards) * inverse
    t = np.einsum("nfk,fk->nf", q, two) * inverse
    return ((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-3) & ~flat).any(axis=1)


def test_shadows_fall_where_rays_say(open_body):
    """At one sample a pixel. Within about a texel of a shadow's edge the map may differ."""
    side, mesh = 64, mesh_of(box((1.0, 1.0, 1.0)), box((2.5, 0.05, 1.5), (0.0, 1.0, 0.0)), box((0.2, 1.5, 0.2)))
    given, sun = views(mesh, 12, side, seed=4), suns(np.random.default_rng(6), 12)
    sun[:, 2] = -0.2
    body = open_body(mesh, np.zeros(mesh.n_faces, np.int32))
    sizes = {"side": side, "supersample": 1}
    full = body.planes(given, sun, **sizes, shadow_px=0)[:, 0]
    shaded = body.planes(given, sun, **sizes, shadow_px=512)[:, 0]
    shadowed = 0
    for k in range(len(given)):
        corners = mesh.placed(given[k].astype(np.float64))[mesh.faces]
        rows, columns = np.nonzero(full[k] > 0.02)
        lines = np.column_stack([columns + 0.5, rows + 0.5, np.full(len(rows), -1000.0)])
        depth = nearest_depth(lines, corners)
        points = np.column_stack([lines[:, :2], depth])
        blocked = rays_blocked(points, sun[k], corners)
        lit = shaded[k][rows, columns] / full[k][rows, columns]
        wrong = (lit > 0.5) == blocked
        assert wrong.mean() < 0.03
        shadowed += blocked.sum()
    assert shadowed > 100
    body.close()


def nearest_depth(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(N,) depth at which lines of sight through (N, 3) points first meet a triangle."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    area = np.cross(b - a, c - a)[:, 2]
    area = np.where(np.abs(area) < 1e-9, np.nan, area)
    v = np.cross(points[:, None] - a, (c - a)[None])[..., 2] / area
    w = np.cross((b - a)[None], points[:, None] - a)[..., 2] / area
    inside = (v >= 0) & (w >= 0) & (v + w <= 1)
    depth = a[:, 2] + v * (b - a)[:, 2] + w * (c - a)[:, 2]
    return np.where(inside, depth, np.inf).min(axis=1)


@pytest.mark.parametrize("turn", [0.0, 0.6, 1.2])
def test_a_lit_panel_does_not_shade_itself_and_its_back_is_dark(turn, open_body):
    """Neither stripes where the Sun is low over a thin panel, nor light that comes through it."""
    panel = mesh_of(box((2.0, 2.0, 0.004)))
    body = open_body(panel, np.zeros(12, np.int32))
    given = np.zeros((1, 1, 3, 4), np.float32)
    cos, sin = np.cos(turn), np.sin(turn)
    given[0, 0, :, :3] = 12.0 * np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
    given[0, 0, :2, 3] = 20.0
    normal = np.array([-np.sin(turn), 0.0, -np.cos(turn)])  # of the side that is seen
    aside = np.array([0.3, 1.0, 0.1])
    aside -= (aside @ normal) * normal
    for height in (0.9, 0.3, 0.05):
        sun = height * normal + np.sqrt(1 - height**2) * aside / np.linalg.norm(aside)
        light, covered, *normals = body.planes(given, sun, **SIZES)[0]
        whole = covered > 0.999
        assert np.stack(normals)[:, whole] == pytest.approx(np.tile(normal[:, None], whole.sum()), abs=1e-5)
        assert light[whole] == pytest.approx(height, rel=0.02)
        back = body.planes(given, sun - 2 * height * normal, **SIZES)[0, 0]
        assert back[whole].max() == 0.0
    body.close()


def test_whole_pixels_and_sizes_move_the_picture_only(open_body):
    mesh = PANEL
    body = open_body(mesh, surface_groups(mesh))
    given, sun = views(mesh, 4, 40, radius=0.3), suns(np.random.default_rng(8), 4)
    moved = given.copy()
    moved[:, :, :2, 3] += np.array([3.0, -2.0], np.float32)
    moved[:, :, 2, 3] += 77.0
    still, shifted = body.planes(given, sun, **SIZES), body.planes(moved, sun, **SIZES)
    assert np.abs(np.roll(still, (-2, 3), axis=(2, 3)) - shifted).sum() < 2e-3 * np.abs(still).sum()
    larger = body.planes(2.0 * given, sun, side=80, supersample=3, shadow_px=128)
    halved = larger.reshape(4, -1, 40, 2, 40, 2).mean(axis=(3, 5))
    finer = body.planes(given, sun, side=40, supersample=6, shadow_px=128)
    assert np.abs(halved - finer).sum() < 2e-3 * np.abs(still).sum()
    body.close()


def test_groups_together_are_the_whole_and_sums_are_the_planes_times_their_weights(open_body):
    mesh = PANEL
    groups, given, sun = surface_groups(mesh), views(mesh, 5, 40), suns(np.random.default_rng(9), 5)
    body, whole = open_body(mesh, groups), open_body(mesh, np.zeros(mesh.n_faces, np.int32))
    planes = body.planes(given, sun, **SIZES, gloss=GLOSS, around=AROUND)
    together = whole.planes(given, sun, **SIZES, gloss=GLOSS, around=AROUND)
    assert planes[:, : body.n_groups].sum(axis=1) == pytest.approx(together[:, 0], abs=1e-5)
    even = slice(body.n_groups, body.n_groups + EVEN_PLANES)
    assert planes[:, even] == pytest.approx(together[:, 1 : 1 + EVEN_PLANES], abs=1e-5)
    lobes = planes[:, even.stop :].reshape(5, len(GLOSS), body.n_groups, 40, 40).sum(axis=2)
    assert lobes == pytest.approx(together[:, 1 + EVEN_PLANES :], abs=1e-5)
    weights = np.random.default_rng(7).uniform(-1, 1, (5, planes.shape[1]))
    wanted = np.einsum("nk,nkij->nij", weights, planes)
    assert body.combined(given, sun, weights, **SIZES, gloss=GLOSS, around=AROUND) == pytest.approx(wanted, abs=2e-5)
    alike = np.einsum("k,nkij->nij", weights[0], planes)
    assert body.combined(given, sun, weights[0], **SIZES, gloss=GLOSS, around=AROUND) == pytest.approx(alike, abs=2e-5)
    together = whole.planes(given, sun, **SIZES, around=AROUND)
    light, coverage = np.moveaxis(body.pictures(given, sun, **SIZES, around=AROUND), 1, 0)
    assert light == pytest.approx(together[:, 0], abs=1e-5)
    assert coverage == pytest.approx(together[:, 1], abs=1e-6)


def test_one_sun_for_all_is_the_same_sun_for_each(open_body):
    body = open_body(PANEL, surface_groups(PANEL))
    given, sun = views(PANEL, 3, 40), np.array([2.0, 1.0, -2.0])
    one = body.planes(given, sun, **SIZES)
    assert np.array_equal(one, body.planes(given, np.tile(sun, (3, 1)), **SIZES))
    assert np.array_equal(one[1:2], body.planes(given[1:2], 5.0 * sun, **SIZES))


def test_nothing_to_draw_gives_zeros_or_nothing(open_body):
    mesh = PANEL
    body = open_body(mesh, surface_groups(mesh))
    given, sun = views(mesh, 7, 40), np.array([0.3, 0.0, -1.0])
    assert body.planes(given[:0], sun, **SIZES).shape == (0, body.n_groups + EVEN_PLANES, 40, 40)
    assert body.pictures(given[:0], sun, **SIZES).shape == (0, 2, 40, 40)
    odd = given.copy()
    odd[0, :, :2, 3] += 500.0
    odd[1, :, :, :3] = 0.0
    odd[2, 0, 1, 2] = np.nan
    odd[3] = np.inf
    odd[4, :, 0] = 0.0  # flat
    odd[5, :, :, :3] *= 1e6  # larger than the patch by far
    found = body.planes(odd, sun, **SIZES)
    assert np.isfinite(found).all()
    assert not found[:5].any()
    assert np.array_equal(found[6], body.planes(given[6:], sun, **SIZES)[0])
    assert not body.planes(given[:1], np.zeros(3), **SIZES).any()


def test_a_mirrored_body_shows_its_outside(open_body):
    mesh = mesh_of(box((1.0, 2.0, 3.0)))
    body = open_body(mesh, np.zeros(12, np.int32))
    given = views(mesh, 3, 40)
    mirrored = given.copy()
    mirrored[:, :, 0] *= -1
    mirrored[:, :, 0, 3] += 40.0
    sun = np.array([0.6, 0.2, -0.7])
    other = body.planes(mirrored, sun * [-1, 1, 1], **SIZES)
    other[:, 2] *= -1  # normals to the right
    assert np.abs(other[..., ::-1] - body.planes(given, sun, **SIZES)).sum() < 2e-3 * np.abs(other).sum()


def test_groups_draw_with_the_sizes_of_a_gpu_what_a_cpu_draws():
    (outer, faces), (inner, _) = box((2.0, 2.0, 2.0), (2.0, 0.0, 0.0)), box((0.5, 0.5, 0.5), (2.0, 0.0, 0.0))
    nested = np.vstack([outer, inner]), [*faces, *(faces + 8)]
    mesh = mesh_of(sphere(6), soup(np.random.default_rng(5), 60, 40), nested)
    groups, given, sun = surface_groups(mesh), views(mesh, 3, 20), suns(np.random.default_rng(2), 3)
    sizes = {"side": 20, "supersample": 3, "shadow_px": 50, "gloss": GLOSS}
    one, other = (open_shaded(mesh, groups, kind=min(USABLE), together=together) for together in (False, True))
    assert np.array_equal(other.drawn_faces, one.drawn_faces) and len(one.drawn_faces) < mesh.n_faces
    assert other.planes(given, sun, **sizes) == pytest.approx(one.planes(given, sun, **sizes), abs=1e-4)
    with pytest.raises(ValueError, match="100 samples"):
        other.planes(given, sun, side=1, supersample=100, shadow_px=0)


def test_more_poses_than_a_launch_leaves_pictures_for(open_body, monkeypatch):
    given, sun = views(PANEL, 7, 20), suns(np.random.default_rng(2), 7)
    body = open_body(PANEL, surface_groups(PANEL))
    weights = np.random.default_rng(7).uniform(-1, 1, (7, body.n_groups + EVEN_PLANES))
    sizes = {"side": 20, "supersample": 2, "shadow_px": 50}
    asked = (lambda: body.planes(given, sun, **sizes), lambda: body.combined(given, sun, weights, **sizes))
    whole = [ask() for ask in asked]
    monkeypatch.setattr("gpu.shaded_forms.LARGEST_RESULT", 3 * whole[1][0].nbytes)
    for ask, wanted in zip(asked, whole, strict=True):
        assert np.array_equal(ask(), wanted)
    body.close()


def test_wrong_questions_are_refused(open_body):
    body = open_body(PANEL, surface_groups(PANEL))
    given, sun = views(PANEL, 2, 40), np.array([0.0, 0.0, -1.0])
    with pytest.raises(ValueError, match="transforms"):
        body.planes(given[:, :1], sun, **SIZES)
    with pytest.raises(ValueError, match="coefficients"):
        body.combined(given, sun, np.ones(2), **SIZES)
    with pytest.raises(ValueError, match="cannot be drawn"):
        body.planes(given, sun, side=0, supersample=1, shadow_px=0)
    with pytest.raises(ValueError, match="groups"):
        open_body(PANEL, np.zeros(3, np.int32))
    with pytest.raises(DeviceError, match="GPU"):
        open_shaded(PANEL, surface_groups(PANEL), reports=(), kind="gpu")
