"""Meshes and poses for the scorers' tests."""

import functools
import json
import struct
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from gpu.mesh import Mesh, assemble, load_mesh
from gpu.raw_part import RawPart

SHAPE = (96, 128)
MESHES = [
    "grace_fo",
    "hubble",
    "iss",
    "mdlsat",
    "shuttle_orbiter",
    "shuttle_orbiter_lod",
    "suomi_npp",
    "tdrs",
    "topex_poseidon",
]  # of ../shared/data/meshes


def mesh_of(*parts: tuple[np.ndarray, np.ndarray]) -> Mesh:
    return assemble([RawPart(f"part{k}", np.asarray(v, float), np.asarray(f)) for k, (v, f) in enumerate(parts)])


def box(size=(1.0, 1.0, 1.0), centre=(0.0, 0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * np.array(size) / 2
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)]
    faces += [(2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
    return corners + np.array(centre), np.array(faces)


def sphere(n=12, radius=1.0, centre=(0.0, 0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    """A closed sphere of n x 2n quadrilaterals, poles as single points."""
    theta = np.linspace(0, np.pi, n + 1)[1:-1]
    phi = np.arange(2 * n) * np.pi / n
    ring = np.stack(
        [
            np.outer(np.sin(theta), np.cos(phi)),
            np.outer(np.sin(theta), np.sin(phi)),
            np.repeat(np.cos(theta)[:, None], 2 * n, 1),
        ],
        axis=-1,
    )
    vertices = np.vstack([[0, 0, 1], ring.reshape(-1, 3), [0, 0, -1]])
    faces = []
    for i in range(2 * n):
        j = (i + 1) % (2 * n)
        faces.append((0, 1 + i, 1 + j))
        for row in range(n - 2):
            a, b = 1 + row * 2 * n, 1 + (row + 1) * 2 * n
            faces += [(a + i, b + i, b + j), (a + i, b + j, a + j)]
        last = 1 + (n - 2) * 2 * n
        faces.append((last + i, len(vertices) - 1, last + j))
    return vertices * radius + np.array(centre), np.array(faces)


def soup(rng: np.random.Generator, n_faces: int, n_vertices: int) -> tuple[np.ndarray, np.ndarray]:
    """Faces among random points: open, flipped, edges with many faces."""
    faces = np.array([rng.choice(n_vertices, 3, replace=False) for _ in range(n_faces)])
    return rng.normal(size=(n_vertices, 3)), faces


def transforms(
    rng: np.random.Generator, mesh: Mesh, n: int, radius_px: float, shape=SHAPE, spread_px: float = 5.0
) -> np.ndarray:
    """(n, P, 3, 4): rotations from all of SO(3), every part turned a little by itself."""
    scale = radius_px / mesh.radius
    out = np.zeros((n, len(mesh.parts), 3, 4), np.float32)
    whole = Rotation.random(n, random_state=rng)
    for p in range(len(mesh.parts)):
        own = Rotation.from_rotvec(rng.normal(size=(n, 3)) * (0.3 if p else 0.0))
        out[:, p, :, :3] = scale * (whole * own).as_matrix()
    centre = np.array([shape[1] / 2, shape[0] / 2]) + rng.normal(size=(n, 2)) * spread_px
    out[:, :, :2, 3] = centre[:, None]
    return out


def a_map(rng: np.random.Generator, shape=SHAPE) -> np.ndarray:
    """A smooth map with noise, like a log-ratio: read-only."""
    rows, columns = np.indices(shape)
    values = 2.0 * np.cos(rows / 17.0) * np.sin(columns / 23.0 + 1.0) + rng.normal(size=shape)
    values = values.astype(np.float32)
    values.flags.writeable = False
    return values


def relative_error(scores: np.ndarray, expected: np.ndarray, magnitude: np.ndarray) -> float:
    """Largest error relative to the score, or to a hundredth of the sum of |map| under the silhouette."""
    return float((np.abs(scores - expected) / np.maximum(np.maximum(np.abs(expected), 0.01 * magnitude), 1e-9)).max())


@functools.cache
def shared_mesh(path: Path) -> Mesh:
    return load_mesh(path.read_bytes(), "glb")


def glb(tree: dict, binary: bytes = b"") -> bytes:
    """A GLB file from its JSON and its binary chunk."""
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def triangle_tree(**changes) -> tuple[dict, bytes]:
    """The JSON and the binary chunk of a GLB with one triangle."""
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    indices = np.array([0, 1, 2], np.uint32)
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "body"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"byteLength": 48}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 36},
            {"buffer": 0, "byteOffset": 36, "byteLength": 12},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"},
        ],
    } | changes
    return tree, positions.tobytes() + indices.tobytes()
