"""Real camera sequences of a known mesh: what is known of their truth, and how an answer's silhouette meets it.

A folder with ``case.json`` is one of ``skypose bench track``. One with ``sequence.json`` has ``mesh``, ``width``,
``height``, ``intrinsics`` (fx, fy, cx, cy: a pinhole camera, px from the first pixel's centre) and ``frames``, each
with ``file`` and ``T_cam_obj``: the (4, 4) matrix from mesh to camera (x right, y down, z ahead), or null.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gpu.lens import Lens
from gpu.mesh import Mesh
from service.bench.folder import SequenceError, SequenceFolder, upload_joints
from service.bench.silhouette import Mask
from service.inference.articulation import Articulation
from service.inference.state import Array, Poses
from service.simulate.compare import silhouette

Truth = Callable[[Mesh, Articulation], Mask]


@dataclass(frozen=True)
class RealSequence:
    """Frames of one camera. ``truth``: from prepared mesh and articulation to the mask (H, W) of a frame's object."""

    name: str
    mesh: Path
    frames: tuple[Path, ...]
    joints: tuple[Mapping[str, Any], ...] | None
    free: tuple[str, ...]
    truth: Mapping[int, Truth]
    lens: Lens | None = None  # of a pinhole camera


def find_real(folder: Path, names: Sequence[str] = (), meshes: Path | None = None) -> list[RealSequence]:
    """The sequences below a folder, by name. Raises ``SequenceError`` where there is none, or none of a wanted name."""
    found = [_pinhole(path.parent) for path in sorted(folder.rglob("sequence.json"))]
    found += [_telescope(path.parent, meshes) for path in sorted(folder.rglob("case.json"))]
    if not found:
        raise SequenceError(f"{folder} holds no sequence: neither sequence.json nor case.json below it")
    for name in names:
        if name not in [one.name for one in found]:
            raise SequenceError(f"no sequence {name!r}; there are {', '.join(one.name for one in found)}")
    return [one for one in found if not names or one.name in names]


def _pinhole(path: Path) -> RealSequence:
    told = json.loads((path / "sequence.json").read_text())
    size = int(told["width"]), int(told["height"])
    camera = np.array([float(told["intrinsics"][name]) for name in ("fx", "fy", "cx", "cy")])
    truth: dict[int, Truth] = {}
    for k, frame in enumerate(told["frames"]):
        if frame["T_cam_obj"] is not None:
            truth[k] = _pinhole_truth(np.array(frame["T_cam_obj"], dtype=np.float64), camera, size)
    files = tuple(path / frame["file"] for frame in told["frames"])
    focal, x, y = 0.5 * (camera[0] + camera[1]), *(camera[2:] + 0.5)  # from the first pixel's corner
    return RealSequence(path.name, path / told["mesh"], files, None, (), truth, (float(focal), float(x), float(y)))


def _pinhole_truth(pose: Array, camera: Array, size: tuple[int, int]) -> Truth:
    return lambda mesh, _: pinhole_mask(mesh, pose, camera, size)


def pinhole_mask(mesh: Mesh, pose: Array, camera: Array, size: tuple[int, int]) -> Mask:
    """(H, W) pixels that a mesh covers before a pinhole camera; ``pose`` (4, 4), ``camera`` fx, fy, cx, cy."""
    points = np.concatenate([part.vertices for part in mesh.parts]) + mesh.centre
    seen = points @ pose[:3, :3].T + pose[:3, 3]
    px = seen[:, :2] / seen[:, 2:] * camera[:2] + camera[2:]
    mask = np.zeros((size[1], size[0]), np.uint8)
    for corners in np.round(16 * px[mesh.faces]).astype(np.int32):
        cv2.fillConvexPoly(mask, corners, 1, shift=4)
    return mask.astype(np.bool_)


def _telescope(path: Path, meshes: Path | None) -> RealSequence:
    told = json.loads((path / "case.json").read_text())
    upload, free = upload_joints(told)
    size = int(told["width"]), int(told["height"])
    files = tuple(sorted((path / "frames").iterdir()))
    with (path / "truth.csv").open(newline="") as file:
        truth = {k: _weak_truth(row, free, size) for k, row in enumerate(csv.DictReader(file)) if row["visible"] == "1"}
    mesh = SequenceFolder(path, () if meshes is None else (meshes,)).mesh(told["mesh"])
    return RealSequence(str(told["name"]), mesh, files, upload, free, truth)


def _weak_truth(row: Mapping[str, str], free: Sequence[str], size: tuple[int, int]) -> Truth:
    numbers = {name: float(value) for name, value in row.items() if value}
    pose = Poses(
        np.array([[numbers[name] for name in ("qw", "qx", "qy", "qz")]]),
        np.array([[numbers["x_px"], numbers["y_px"]]]),
        np.log([numbers["scale_px"]]),
        np.array([[numbers[name] for name in free]]),
    )
    return lambda mesh, articulation: np.asarray(silhouette(mesh, articulation, pose, size), np.bool_)
