"""How long sunlit drawing and evidence take, and how far drawing agrees with its twin in NumPy."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.box import MARKDOWN
from rich.table import Table
from scipy.spatial.transform import Rotation

from gpu.coarse_mesh import coarse_mesh
from gpu.evidence import open_evidence
from gpu.evidence_terms import LANES
from gpu.mesh import Mesh
from gpu.shaded import ShadedBody, open_shaded
from gpu.shaded_reference import Drawing, reference_planes
from gpu.surface_groups import surface_groups
from service.inference.model.likelihood import ROUNDS
from service.inference.model.prior import GLOSS_LOBES
from service.inference.model.scene import Scene
from service.inference.model.spread import PointSpread, spread
from service.inference.model.terms import terms_of

FILL = 0.48  # of the patch: the body's radius in it
AGREES = 0.02  # of full light: pixels that differ by less are the same
GLOSS = (20.0,)
SEEING, SIGMA, PHOTON = PointSpread(1.2), 5.0, 0.5  # of the frame whose evidence is asked for; counts
_SHORTEST_S = 0.05  # a call below this is measured with more poses


@dataclass(frozen=True)
class LightPlan:
    """What is drawn, and how often."""

    side: int = 64
    supersample: int = 3
    shadow_px: int = 256
    template_side: int = 32
    template_supersample: int = 2
    template_shadow_px: int = 128
    poses: int = 400
    repeats: int = 5
    compared: int = 6  # poses of which the twin is asked
    seed: int = 0
    coarse: bool = True  # draw the mesh for this size, not the file's
    kind: str = "cpu"  # of the device
    launches: tuple[int, ...] = ()  # poses of a launch, in turns, instead of `poses`: a GPU is filled by many
    weighed: tuple[
        int, ...
    ] = ()  # poses whose evidence is asked for at once, in turns, instead of an eighth of `poses`

    @property
    def counts(self) -> tuple[int, ...]:
        """Poses of a launch."""
        return self.launches or (self.poses,)


@dataclass(frozen=True)
class LightRow:
    """One way of drawing one mesh. Times are the shortest of the repeats, over all cores together."""

    mesh: str
    faces: int  # of the file
    drawn_faces: int
    way: str
    side: int
    shadow_px: int
    poses: int  # of a launch
    us_per_pose: float
    kernel_us: float | None  # of it in the kernel, as the device says: the rest is transfers and the host's
    agreement: float | None  # share of covered pixels that agree with the twin on what is drawn


def bench_light(bodies: Mapping[str, Mesh], plan: LightPlan, say: Callable[[str], None]) -> list[LightRow]:
    """Rows of all bodies. Raises ``DeviceError`` where there is no device of this kind."""
    rows = []
    for name, mesh in bodies.items():
        say(f"{name}: {mesh.n_faces} faces")
        rows += [*_planes_rows(name, mesh, plan), *_template_rows(name, mesh, plan)]
        rows += _evidence_rows(name, mesh, plan)
    return rows


def light_document(machine: Mapping[str, Any], rows: Sequence[LightRow]) -> dict[str, Any]:
    """The JSON: ``machine``, ``rows``."""
    return {"machine": dict(machine), "rows": [asdict(row) for row in rows], "absent": {}}


def light_table(rows: Sequence[LightRow]) -> Table:
    """A line per mesh and way."""
    table = Table(title="µs per pose", title_justify="left", box=MARKDOWN)
    for name in ("mesh", "faces", "drawn", "way", "px", "shadow px", "poses", "µs", "in the kernel", "agrees"):
        table.add_column(name, justify="left" if name in ("mesh", "way") else "right", no_wrap=True)
    for row in rows:
        agrees = "-" if row.agreement is None else f"{row.agreement:.4f}"
        kernel = "-" if row.kernel_us is None else f"{row.kernel_us:.2f}"
        cells = (row.mesh, f"{row.faces:,}", f"{row.drawn_faces:,}", row.way, str(row.side), str(row.shadow_px))
        table.add_row(*cells, f"{row.poses:,}", f"{row.us_per_pose:.2f}", kernel, agrees)
    return table


def views(mesh: Mesh, count: int, side: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """(N, P, 3, 4) transforms: turned at random, in the middle of the patch."""
    out = np.zeros((count, len(mesh.parts), 3, 4), np.float32)
    turns = Rotation.random(count, random_state=rng).as_matrix()
    out[..., :3] = (FILL * side / mesh.radius) * turns[:, None]
    out[..., :2, 3] = 0.5 * side
    return out


def _planes_rows(name: str, mesh: Mesh, plan: LightPlan) -> list[LightRow]:
    side, supersample, shadow_px = plan.side, plan.supersample, plan.shadow_px
    drawn, groups = _prepared(mesh, side, plan)
    body, rng = open_shaded(drawn, groups, kind=plan.kind), _rng(plan)
    given, suns = views(drawn, max(plan.counts), side, rng), _suns(max(plan.counts), rng)
    shares = np.concatenate([np.linspace(0.5, 1.0, body.n_groups), [0.04, 0.0, 0.0, 0.0]])

    def planes(n: int) -> NDArray[np.float32]:
        few = given[:n], suns[:n]
        return body.planes(*few, side=side, supersample=supersample, shadow_px=shadow_px, gloss=GLOSS)

    def combined(n: int, texels: int) -> NDArray[np.float32]:
        return body.combined(given[:n], suns[:n], shares, side=side, supersample=supersample, shadow_px=texels)

    agreement = _agreement(body, (drawn, groups), given[: plan.compared], suns[: plan.compared], plan)
    rows = []
    for n in plan.counts:
        few = max(1, n // 8)
        ways: tuple[tuple[str, int, Callable[[], object], int], ...] = (
            ("planes", shadow_px, partial(planes, few), few),
            ("combined", shadow_px, partial(combined, n, shadow_px), n),
            ("combined", 0, partial(combined, n, 0), n),
        )
        for way, texels, draw, count in ways:
            spent = _us(draw, count, plan.repeats), _kernel_us(body.kernel_seconds, count)
            agrees = agreement if way == "planes" else None
            rows.append(LightRow(name, mesh.n_faces, drawn.n_faces, way, side, texels, count, *spent, agrees))
    body.close()
    return rows


def _template_rows(name: str, mesh: Mesh, plan: LightPlan) -> list[LightRow]:
    side, texels = plan.template_side, plan.template_shadow_px
    drawn, groups = _prepared(mesh, side, plan)
    body, rng = open_shaded(drawn, groups, kind=plan.kind), _rng(plan)
    given, suns = views(drawn, max(plan.counts), side, rng), _suns(max(plan.counts), rng)

    def pictures(n: int) -> object:
        few = given[:n], suns[:n]
        return body.pictures(*few, side=side, supersample=plan.template_supersample, shadow_px=texels)

    rows = []
    for n in plan.counts:
        spent = _us(partial(pictures, n), n, plan.repeats), _kernel_us(body.kernel_seconds, n)
        rows.append(LightRow(name, mesh.n_faces, drawn.n_faces, "templates", side, texels, n, *spent, None))
    body.close()
    return rows


def _evidence_rows(name: str, mesh: Mesh, plan: LightPlan) -> list[LightRow]:
    """Evidence of drawn poses in a frame of the first one, every unknown of a sharp one among them."""
    side = -(-plan.side // LANES) * LANES
    drawn, groups = _prepared(mesh, side, plan)
    body, light, rng = open_shaded(drawn, groups, kind=plan.kind), open_evidence(plan.kind), _rng(plan)
    few = max(1, plan.poses // 8)
    given, suns = views(drawn, few, side, rng), _suns(few, rng)
    planes = body.planes(
        given, suns, side=side, supersample=plan.supersample, shadow_px=plan.shadow_px, gloss=GLOSS_LOBES
    )
    scene = _frame(planes[0], body.n_groups, rng)
    terms = terms_of(scene, body.n_groups, planes.shape[1])
    rows = []
    for n in plan.weighed or (few,):
        ask = partial(light.evidence, planes, body.n_groups, terms, ROUNDS, [k % few for k in range(n)])
        spent = _us(ask, n, plan.repeats), _kernel_us(light.kernel_seconds, n)
        rows.append(LightRow(name, mesh.n_faces, drawn.n_faces, "evidence", side, plan.shadow_px, n, *spent, None))
    light.close()
    body.close()
    return rows


def _frame(planes: NDArray[np.float32], n_groups: int, rng: np.random.Generator) -> Scene:
    """What a camera sees of a body of many albedos, without gloss."""
    bright = 900.0 * np.tensordot(np.exp(rng.normal(0, 0.5, n_groups)), planes[:n_groups], 1)
    seen = spread(np.asarray(bright, np.float32)[None], SEEING, 0.0)[0]
    image = np.asarray(seen + rng.normal(0, np.sqrt(SIGMA**2 + PHOTON * seen)), np.float32)
    return Scene(image, SIGMA, PHOTON, 40.0, np.zeros(image.shape, bool), SEEING)


def _rng(plan: LightPlan) -> np.random.Generator:
    return np.random.default_rng(plan.seed)


def _prepared(mesh: Mesh, side: int, plan: LightPlan) -> tuple[Mesh, NDArray[np.int32]]:
    groups = surface_groups(mesh)
    return coarse_mesh(mesh, groups, FILL * side) if plan.coarse else (mesh, groups)


def _suns(count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """(N, 3) unit vectors at phase angles below 120 degrees."""
    suns = rng.normal(size=(4 * count, 3))
    suns /= np.linalg.norm(suns, axis=1, keepdims=True)
    return np.resize(suns[suns[:, 2] < 0.5], (count, 3))


def _agreement(
    body: ShadedBody,
    drawn: tuple[Mesh, NDArray[np.int32]],
    given: NDArray[np.float32],
    suns: NDArray[np.float64],
    plan: LightPlan,
) -> float | None:
    """Share of the pixels that show the body in which no plane differs from the twin's by ``AGREES``."""
    if len(given) == 0:
        return None
    drawing = Drawing(plan.side, plan.supersample, plan.shadow_px, GLOSS)
    wanted = reference_planes(*drawn, given, suns, drawing)
    found = body.planes(
        given, suns, side=plan.side, supersample=plan.supersample, shadow_px=plan.shadow_px, gloss=GLOSS
    )
    covered = wanted[:, body.n_groups] > 0
    same = np.abs(found - wanted).max(axis=1) < AGREES
    return float(same[covered].mean())


def _us(draw: Callable[[], object], poses: int, repeats: int) -> float:
    """Microseconds per pose, the shortest of the repeats."""
    draw()  # builds what is built once
    spent = []
    for _ in range(repeats):
        calls, start = 0, time.perf_counter()
        while calls == 0 or time.perf_counter() - start < _SHORTEST_S:
            draw()
            calls += 1
        spent.append((time.perf_counter() - start) / (calls * poses))
    return 1e6 * min(spent)


def _kernel_us(seconds: float, poses: int) -> float | None:
    return 1e6 * seconds / poses if seconds else None
