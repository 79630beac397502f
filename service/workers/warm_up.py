"""What a new worker does before its first job, so that the job need not wait for it."""

from __future__ import annotations

import warnings

import numpy as np

from gpu.errors import ScorerError
from gpu.mesh import assemble
from gpu.raw_part import RawPart
from gpu.scorer import open_scorer
from service.inference.articulation import Articulation
from service.workers.lit_body import LitBody

_CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
_FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def build_kernels() -> None:
    """Find the devices, and build or load what frames run on the first one, by opening a tetrahedron."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a machine without a device is told so by the first session
        try:
            mesh = assemble([RawPart("tetrahedron", _CORNERS, _FACES)])
            LitBody(mesh, Articulation(("tetrahedron",))).close()
            scorer = open_scorer(mesh)
            pose = np.array([[[[4, 0, 0, 8], [0, 4, 0, 8], [0, 0, 4, 0]]]], np.float32)
            scorer.score(pose, np.ones((16, 16), np.float32))
            scorer.close()
        except ScorerError:  # the first frame meets it too, and says so to its client
            return
