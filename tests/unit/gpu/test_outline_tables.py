"""Edges, pieces, cells and blocks: what the kernels are given."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "gpu"))

from gpu_cases import box, mesh_of, soup, sphere

from gpu.cells import AXES, cell_corners, cell_count, possible_outline
from gpu.clusters import LANES, build_table
from gpu.components import components
from gpu.edges import outline_edges


def contributions(edges, direction):
    return np.sign(edges.normal_a @ direction) - np.sign(edges.normal_b @ direction)


def as_mesh(vertices, faces):
    return vertices, np.asarray(faces, np.int32)


def test_a_box_has_twelve_edges_and_no_diagonals():
    edges = outline_edges(*as_mesh(*box()))
    assert len(edges) == 12
    assert set(contributions(edges, np.array([0.3, 0.5, 0.8]))) == {-2.0, 0.0, 2.0}
    assert np.count_nonzero(contributions(edges, np.array([0.3, 0.5, 0.8]))) == 6


def test_a_border_counts_once_from_either_side():
    edges = outline_edges(*as_mesh(np.eye(3), [[0, 1, 2]]))
    ahead = contributions(edges, np.ones(3))
    assert np.abs(ahead).tolist() == [1, 1, 1]
    assert np.array_equal(contributions(edges, -np.ones(3)), -ahead)


def test_a_flipped_neighbour_is_counted_with_positive_area():
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    flipped = outline_edges(*as_mesh(square, [[0, 1, 2], [0, 3, 2]]))
    proper = outline_edges(*as_mesh(square, [[0, 1, 2], [0, 2, 3]]))
    assert len(flipped) == len(proper) == 4


@pytest.mark.parametrize("seed", range(5))
def test_the_windings_at_a_vertex_sum_to_zero(seed):
    """Each face is a closed loop, whatever its neighbours: nothing is left over at the end of a row."""
    rng = np.random.default_rng(seed)
    vertices, faces = as_mesh(*soup(rng, 40, 15))
    edges = outline_edges(vertices, faces)
    for direction in rng.normal(size=(20, 3)):
        flow = contributions(edges, direction)
        total = np.bincount(edges.ends[:, 0], flow, 15) - np.bincount(edges.ends[:, 1], flow, 15)
        assert not total.any()


@pytest.mark.parametrize("across", [1, 5, 12])
def test_an_edge_that_a_cell_leaves_out_is_outline_from_nowhere_in_it(across):
    rng = np.random.default_rng(3)
    edges = outline_edges(*as_mesh(*soup(rng, 60, 20)))
    possible = possible_outline(edges, across)
    assert possible.shape == (cell_count(across), len(edges))
    for direction in rng.normal(size=(300, 3)):
        face = int(np.argmax(np.abs(direction)))
        d = direction / direction[face]
        u, v = (int((d[axis] + 1) / 2 * across) for axis in AXES[face][1:])
        outline = contributions(edges, direction) != 0
        assert not (outline & ~possible[(face * across + v) * across + u]).any()


def test_corners_of_neighbouring_cells_are_unit_directions():
    corners = cell_corners(4)
    assert corners.shape == (3, 5, 5, 3)
    assert np.allclose(np.linalg.norm(corners, axis=-1), 1)


def test_pieces_share_no_edge_and_lose_no_face():
    (v1, f1), (v2, f2) = sphere(5), box(centre=(5, 0, 0))
    found = components(np.vstack([v1, v2]), np.vstack([f1, f2 + len(v1)]).astype(np.int32))
    assert sorted(len(piece.faces) for piece in found) == sorted([len(f1), len(f2)])


def test_the_box_of_a_piece_holds_it():
    rng = np.random.default_rng(4)
    vertices, faces = box((5, 0.1, 0.3))
    turned = vertices @ np.linalg.qr(rng.normal(size=(3, 3)))[0] + rng.normal(size=3)
    (piece,) = components(turned, faces.astype(np.int32))
    centre, arms = piece.box[0], piece.box[1:]
    along = (turned - centre) @ arms.T / (arms**2).sum(axis=1)
    assert np.abs(along).max() == pytest.approx(1.0)


def test_blocks_hold_every_edge_once_and_lists_name_what_a_cell_can_see():
    mesh = mesh_of(sphere(8), box())
    table = build_table(mesh, None, across=4)
    n_edges = [len(outline_edges(part.vertices, part.faces)) for part in mesh.parts]
    used = (table.blocks[:, 6:].any(axis=1)).sum()
    assert used == sum(n_edges)
    assert table.starts.shape == (len(mesh.parts) * cell_count(4) + 1,)
    assert table.lists[:, 0].max() < len(table.blocks)
    assert (table.lists[:, 1] > 0).all()
    assert (table.lists[:, 1] < 1 << LANES).all()
    for part, edges in enumerate(n_edges):
        cells = slice(table.starts[part * cell_count(4)], table.starts[(part + 1) * cell_count(4)])
        assert np.bitwise_count(table.lists[cells, 1]).sum() < edges * cell_count(4)


def test_a_hidden_piece_is_listed_nowhere():
    (v1, f1), (v2, f2) = sphere(5), box((0.1, 0.1, 0.1))
    mesh = mesh_of((np.vstack([v1, v2]), np.vstack([f1, f2 + len(v1)])))

    def hide_small(_vertices, pieces, possible, _across):
        return np.tile([len(piece.faces) == 12 for piece in pieces], (len(possible[0]), 1))

    assert build_table(mesh, hide_small, 3).blocks[:, 6:].any(axis=1).sum() == len(
        outline_edges(v1, f1.astype(np.int32))
    )
