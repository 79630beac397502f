"""What a new worker does before its first job, so that the job need not wait for it.

``python -m service.workers.warm_up`` does it once for all services of this installation (``deploy/setup``).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np

from gpu.errors import ScorerError
from gpu.kernel_cache import INSTALLED, KernelCache
from gpu.mesh import assemble
from gpu.raw_part import RawPart
from gpu.scorer import open_scorer
from service.inference.articulation import Articulation
from service.inference.model.derivatives import derivatives
from service.inference.model.drawing import Drawing, Quality, View
from service.inference.model.scene import Scene
from service.inference.model.spread import PointSpread
from service.inference.model.terms import terms_of
from service.inference.state import Poses
from service.workers.lit_body import LitBody

_CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
_FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
_SIDE = 16


def build_kernels(built: Callable[[], None] = lambda: None) -> None:
    """Find the devices, and build or load what frames run on the first one, by drawing a tetrahedron.

    Every kernel is launched: a driver may leave half of its work until then. ``built`` is called after some of them, so
    that a worker that is ended over it has not built them in vain.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a machine without a device is told so by the first session
        try:
            mesh = assemble([RawPart("tetrahedron", _CORNERS, _FACES)])
            body = LitBody(mesh, Articulation(("tetrahedron",)))
            built()
            _draw(body.body.fine)
            body.close()
            built()
            scorer = open_scorer(mesh)
            pose = np.array([[[[4, 0, 0, 8], [0, 4, 0, 8], [0, 0, 4, 0]]]], np.float32)
            scorer.score(pose, np.ones((_SIDE, _SIDE), np.float32))
            scorer.close()
            built()
        except ScorerError:  # the first frame meets it too, and says so to its client
            return


def _draw(drawing: Drawing) -> None:
    """One picture, its evidence, and what its slopes say."""
    pose = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), np.full((1, 2), 0.5 * _SIDE), np.log([4.0]), np.zeros((1, 0)))
    look = pose, np.array([[0.0, 0.0, -1.0]])
    view, quality = View((0.0, 0.0), 1.0, _SIDE), Quality(1, _SIDE)
    planes = drawing.cut(*look, view, quality)
    empty = np.zeros((_SIDE, _SIDE), np.float32)
    blur = PointSpread(1.0), 0.0
    scene = Scene(empty, 1.0, 1.0, 1.0, empty > 0, blur[0])
    groups = drawing.n_groups
    terms = terms_of(scene, groups, drawing.n_planes(quality))
    answers, details = drawing.light.details(planes, groups, terms, 1)
    given = drawing, view, quality, blur, *look, answers.coefficients
    slopes = derivatives(*given, difference=1.0, sun_free=False)
    if drawing.slopes is not None:
        drawing.slopes.systems(slopes, [details[0].row], None)


if __name__ == "__main__":
    kernels = KernelCache(INSTALLED)
    kernels.open()
    build_kernels(kernels.keep)
    kernels.close()
