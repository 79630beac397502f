"""Scorers against each other: time per particle, in one run and in turns, and agreement with the reference.

All particles of a measurement show the whole body: rotations uniform on SO(3), the bounding sphere's disc as large as
half of the image, its place uniform where nothing is cut off. The map is on the device before the clock starts.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, binary_erosion, gaussian_filter
from scipy.spatial.transform import Rotation

from gpu import scorer as scorers
from gpu.errors import ScorerError
from gpu.looping import Floats, Map, Transforms
from gpu.mesh import Mesh
from gpu.reference import silhouette_mask

COVERED = 0.5  # of the image, by the disc of the bounding sphere
TOLERANCE = 1e-4  # of a score, where a scorer decides pixel by pixel as the reference does
LEAST_SHARE = 0.01  # of the map's magnitude under the silhouette: what a score near zero is compared with
LARGEST_GROWTH = 10.0  # of a batch from one try to the next
JOINT_RAD = 0.5  # greatest angle between parts

Open = Callable[[Mesh], scorers.Scorer]


@dataclass(frozen=True)
class Contestant:
    """A scorer by name. ``draws_edges``: its rasteriser decides about the pixels along the edge by rules of its own."""

    name: str
    open: Open
    draws_edges: bool = False


@dataclass(frozen=True)
class Plan:
    """What is measured, and how long."""

    sizes_px: tuple[int, ...] = (256, 512, 1024)
    repeats: int = 7
    call_s: float = 0.2  # a call takes as many particles as fill this time
    most_particles: int = 1 << 17
    checked: int = 4  # particles whose score is compared with the reference
    seed: int = 0


QUICK = Plan(repeats=3, call_s=0.05, most_particles=1 << 14, checked=2)


@dataclass(frozen=True)
class ScorerRow:
    """A scorer, a mesh and a size.

    ``max_rel_error`` is relative to the score, or to a hundredth of the sum of |map| under the silhouette where that is
    more. ``edge_error`` is the same difference over the sum of |map| within a pixel of the silhouette's edge.
    """

    backend: str
    device: str
    faces: int
    size_px: int
    us_per_particle: float  # median
    us_least: float
    particles: int  # per call
    max_rel_error: float
    edge_error: float
    agrees: bool


@dataclass
class ScorerFigures:
    """Rows, and why a contestant has none."""

    rows: list[ScorerRow] = field(default_factory=list)
    absent: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class _Scene:
    """A mesh in an image of one size."""

    mesh: Mesh
    log_ratio: Map
    poses: Transforms
    expected: Floats  # (checked,) scores of the first particles
    magnitude: Floats  # (checked,) sums of |map| under their silhouettes
    edge: Floats  # (checked,) sums of |map| within a pixel of their edges


def contestants(names: Sequence[str] | None = None) -> list[Contestant]:
    """Every backend that ``open_scorer`` offers by name, or those named. Raises ``ScorerError`` for an unknown one."""
    offered = [name for name in scorers.BACKENDS if name != "auto"]
    for name in names or ():
        if name not in offered:
            raise ScorerError(f"scorer backend {name!r} is not one of {', '.join(offered)}")
    return [
        Contestant(name, partial(scorers.open_scorer, backend=name), name == "opengl")
        for name in offered
        if names is None or name in names
    ]


def bench_scorers(
    entries: Sequence[Contestant],
    meshes: Sequence[Mesh],
    plan: Plan,
    tell: Callable[[str], None] = lambda line: None,
) -> ScorerFigures:
    """Measure all contestants on all meshes and sizes; those of one scene take turns, call by call."""
    figures = ScorerFigures()
    for mesh in meshes:
        with ExitStack() as stack:
            opened: dict[str, scorers.Scorer] = {}
            for entry in entries:
                with told_absent(figures.absent, entry.name):
                    opened[entry.name] = entry.open(mesh)
                    stack.callback(opened[entry.name].close)
            for size_px in plan.sizes_px:
                tell(f"{mesh.n_faces} faces, {size_px} px")
                _measure_scene(entries, opened, scene(mesh, size_px, plan), figures, plan)
    return figures


def uniform_poses(rng: np.random.Generator, mesh: Mesh, count: int, size_px: int) -> Transforms:
    """(count, P, 3, 4) transforms of whole bodies in a square image; parts turn a little against each other."""
    radius_px = size_px * float(np.sqrt(COVERED / np.pi))
    whole = Rotation.random(count, random_state=rng)
    place = rng.uniform(radius_px, size_px - radius_px, (count, 2))
    poses = np.zeros((count, len(mesh.parts), 3, 4), np.float32)
    for p in range(len(mesh.parts)):
        turn = Rotation.from_rotvec(rng.uniform(0.0, JOINT_RAD if p else 0.0, (count, 1)) * np.array([[0.0, 1.0, 0.0]]))
        poses[:, p, :, :3] = radius_px / mesh.radius * (whole * turn).as_matrix()
    poses[:, :, :2, 3] = place[:, None]
    return poses


def scene(mesh: Mesh, size_px: int, plan: Plan) -> _Scene:
    """A map like a frame's (a bright body on a dark sky, with noise), particles, and the reference's answers."""
    rng = np.random.default_rng([plan.seed, mesh.n_faces, size_px])
    shape = (size_px, size_px)
    poses = uniform_poses(rng, mesh, plan.most_particles, size_px)
    seen = silhouette_mask(mesh, poses[0], shape).astype(np.float32)
    noise = rng.standard_normal(shape)
    log_ratio = np.asarray(3.0 * gaussian_filter(seen, 1.5) - 1.0 + 0.3 * noise, dtype=np.float32)
    log_ratio.flags.writeable = False  # so that it is kept on the device
    values = log_ratio.astype(np.float64)
    masks = [silhouette_mask(mesh, pose, shape) for pose in poses[: plan.checked]]
    expected, magnitude, edge = (np.empty(len(masks)) for _ in range(3))
    for k, mask in enumerate(masks):
        expected[k], magnitude[k] = values[mask].sum(), np.abs(values[mask]).sum()
        edge[k] = np.abs(values[edge_band(mask)]).sum()
    return _Scene(mesh, log_ratio, poses, expected, magnitude, edge)


def edge_band(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(H, W) pixels within one pixel, diagonals included, of the edge of a silhouette."""
    around = np.ones((3, 3), dtype=bool)
    band = binary_dilation(mask, around) & ~binary_erosion(mask, around, border_value=1)
    return np.asarray(band, dtype=bool)


def _measure_scene(
    entries: Sequence[Contestant],
    opened: Mapping[str, scorers.Scorer],
    now: _Scene,
    figures: ScorerFigures,
    plan: Plan,
) -> None:
    batch: dict[str, int] = {}
    for name, scorer in opened.items():
        if name not in figures.absent:
            with told_absent(figures.absent, name):
                batch[name] = _batch(scorer, now, plan)
    us: dict[str, list[float]] = {name: [] for name in batch}
    for repeat in range(plan.repeats):
        for name, count in batch.items():
            if name not in figures.absent:
                with told_absent(figures.absent, name):
                    us[name].append(1e6 / count * _call_s(opened[name], now, count, repeat))
    for entry in entries:
        if entry.name in batch and entry.name not in figures.absent:
            with told_absent(figures.absent, entry.name):
                figures.rows.append(_row(entry, opened[entry.name], now, us[entry.name], batch[entry.name]))


def _batch(scorer: scorers.Scorer, now: _Scene, plan: Plan) -> int:
    """Particles that fill ``call_s``. Kernels are built and the map is loaded before."""
    count = 1
    _call_s(scorer, now, count, 0)
    while True:
        taken = _call_s(scorer, now, count, 0)
        if taken >= 0.5 * plan.call_s or count == len(now.poses):
            return count
        growth = min(LARGEST_GROWTH, plan.call_s / max(taken, 1e-9))
        count = min(len(now.poses), int(np.ceil(count * growth)))


def _call_s(scorer: scorers.Scorer, now: _Scene, count: int, repeat: int) -> float:
    """Seconds of one call; every repeat has particles of its own where there are enough."""
    first = (repeat * count) % (len(now.poses) - count + 1)
    poses = now.poses[first : first + count]
    began = time.perf_counter()
    scorer.score(poses, now.log_ratio)
    return time.perf_counter() - began


def _row(entry: Contestant, scorer: scorers.Scorer, now: _Scene, us: Sequence[float], count: int) -> ScorerRow:
    scores = scorer.score(now.poses[: len(now.expected)], now.log_ratio)
    difference = np.abs(scores - now.expected)
    scale = np.maximum(np.maximum(np.abs(now.expected), LEAST_SHARE * now.magnitude), 1e-9)
    relative = float(np.max(difference / scale))
    edge = float(np.max(difference / np.maximum(now.edge, 1e-9)))
    return ScorerRow(
        backend=entry.name,
        device=scorer.name,
        faces=now.mesh.n_faces,
        size_px=now.log_ratio.shape[0],
        us_per_particle=float(np.median(us)),
        us_least=float(np.min(us)),
        particles=count,
        max_rel_error=relative,
        edge_error=edge,
        agrees=relative <= TOLERANCE or (entry.draws_edges and edge <= 1.0),
    )


@contextmanager
def told_absent(absent: dict[str, str], name: str) -> Iterator[None]:
    """A contestant that cannot be opened or used is told of in ``absent``; the others go on."""
    try:
        yield
    except ScorerError as error:
        absent[name] = str(error)
