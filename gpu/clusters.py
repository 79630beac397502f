"""Edges in blocks of sixteen that are outline from about the same directions, and per cell the blocks to look at."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpu.cells import cell_count, possible_outline
from gpu.components import Component, components
from gpu.edges import Edges
from gpu.mesh import Mesh

LANES = 16
SAMPLED_CELLS = 200  # by which edges are compared
LARGEST_TABLE = 40_000_000  # edges times cells: bounds memory and time while the table is made

HiddenPieces = Callable[[NDArray[np.float64], Sequence[Component], Sequence[NDArray[np.bool_]], int], NDArray[np.bool_]]


@dataclass(frozen=True)
class OutlineTable:
    """What the kernels read.

    ``blocks`` (C, 12, 16) holds per lane an edge: ends a and b, then the normals of ``gpu.edges`` (all zero: no
    edge). What part p may show in cell c is ``lists[starts[i]:starts[i + 1]]`` with ``i = p * cells + c``: pairs of a
    block's number and a mask of its lanes (bit k: lane k is to be looked at).
    """

    blocks: NDArray[np.float32]
    starts: NDArray[np.int32]
    lists: NDArray[np.int32]  # (L, 2)
    across: int  # cells along a side of a cube face


def build_table(mesh: Mesh, hidden_pieces: HiddenPieces | None, across: int = 16) -> OutlineTable:
    """Cluster the outline edges of every part; ``hidden_pieces`` says which pieces a cell need not draw."""
    across = min(across, max(1, int(np.sqrt(LARGEST_TABLE / (3 * max(1, 3 * mesh.n_faces // 2))))))
    blocks: list[NDArray[np.float32]] = []
    listed: list[NDArray[np.int32]] = []
    for part in mesh.parts:
        pieces = components(part.vertices, part.faces)
        possible = [possible_outline(piece.edges, across) for piece in pieces]
        hidden = np.zeros((cell_count(across), len(pieces)), dtype=bool)
        if hidden_pieces is not None and len(pieces) > 1:
            hidden = hidden_pieces(part.vertices, pieces, possible, across)
        wanted = [flags & ~hidden[:, k, None] for k, flags in enumerate(possible)]
        part_blocks, seen = _cluster(part.vertices, [piece.edges for piece in pieces], np.hstack(wanted))
        blocks.append(part_blocks)
        listed.append(seen)
    starts, lists = _compressed(listed)
    return OutlineTable(np.ascontiguousarray(np.concatenate(blocks)), starts, lists, across)


def _cluster(
    vertices: NDArray[np.float64], edges: Sequence[Edges], wanted: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Blocks (C, 12, 16) of the edges that some cell wants, given (cells, E) flags, and (cells, C) masks of lanes."""
    ends = np.concatenate([e.ends for e in edges])
    values = np.hstack(
        [
            vertices[ends[:, 0]],
            vertices[ends[:, 1]],
            np.concatenate([e.normal_a for e in edges]),
            np.concatenate([e.normal_b for e in edges]),
        ]
    )
    used = np.flatnonzero(wanted.any(axis=0))
    sample = np.linspace(0, len(wanted) - 1, min(len(wanted), SAMPLED_CELLS)).astype(int)
    order = used[_similar_together(np.ascontiguousarray(wanted[sample][:, used].T))]
    n_blocks = -(-len(order) // LANES)
    lanes = np.zeros((n_blocks * LANES, 12), np.float32)
    lanes[: len(order)] = values[order]
    flags = np.zeros((len(wanted), n_blocks * LANES), dtype=bool)
    flags[:, : len(order)] = wanted[:, order]
    blocks = lanes.reshape(n_blocks, LANES, 12).transpose(0, 2, 1)
    masks = np.packbits(flags, axis=1, bitorder="little").view("<u2")
    return blocks, masks.astype(np.int32)


def _similar_together(views: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Order edges by their (E, views) visibility: halve along the principal direction until a block is left."""
    values = views.astype(np.float32)
    ordered: list[NDArray[np.int64]] = []
    stack = [np.arange(len(values))]
    while stack:
        group = stack.pop()
        if len(group) <= LANES:
            ordered.append(group)
            continue
        along = _principal_coordinate(values[group])
        order = group[np.argsort(along, kind="stable")]
        half = max(LANES, (len(group) // 2 + LANES // 2) // LANES * LANES)
        stack += [order[:half], order[half:]]
    return np.concatenate(ordered)


def _principal_coordinate(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Coordinate of each row along the direction of greatest variance (a few power iterations are near enough)."""
    centred = values - values.mean(axis=0)
    direction = np.linspace(1.0, 2.0, centred.shape[1], dtype=np.float32)
    for _ in range(6):
        direction = centred.T @ (centred @ direction)
        direction /= max(float(np.linalg.norm(direction)), 1e-30)
    return np.asarray(centred @ direction, dtype=np.float32)


def _compressed(masks: Sequence[NDArray[np.int32]]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """(cells, C) lane masks per part -> starts, and lists of (block, mask), parts after each other."""
    starts, lists, first = [np.zeros(1, np.int64)], [], 0
    for mask in masks:
        cell, block = np.nonzero(mask)
        lists.append(np.stack([block + first, mask[cell, block]], axis=1))
        starts.append(starts[-1][-1] + np.cumsum((mask != 0).sum(axis=1)))
        first += mask.shape[1]
    return np.concatenate(starts).astype(np.int32), np.concatenate(lists).astype(np.int32)
