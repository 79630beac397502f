"""The paper's GPU path: OpenGL draws all silhouettes of a batch into an atlas, OpenCL sums the map under each."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace

import moderngl
import numpy as np
import pyopencl as cl

from gpu.atlas import Bounds, atlas_size
from gpu.device import DeviceReport, open_device
from gpu.errors import DeviceError, ImageSizeError
from gpu.gl_memory import current_egl, has_buffer_storage
from gpu.interop import (
    CopyHandOver,
    GlSharingHandOver,
    HandOver,
    HandOverChoice,
    HostSharedHandOver,
    choose_hand_over,
)
from gpu.looping import Floats, LoopingScorer, Map, Transforms
from gpu.mesh import Mesh
from gpu.program import device_errors
from gpu.reducer import Reducer
from gpu.renderer import Renderer, gl_errors, open_gl

GL_CONTEXT, EGL_DISPLAY = 0x2008, 0x2009  # CL_GL_CONTEXT_KHR, CL_EGL_DISPLAY_KHR: pyopencl names them if built with GL


class OpenGLScorer(LoopingScorer):
    """Scores with OpenGL and OpenCL. Owned, used and closed by one thread.

    OpenGL decides which pixels a face covers: it agrees with the others but for a band of one pixel at the edges.
    ``hand_over`` forces one of ``gl_sharing``, ``host_shared``, ``copy``; by default ``choose_hand_over`` decides.
    """

    def __init__(self, mesh: Mesh, report: DeviceReport, hand_over: str | None = None) -> None:
        with ExitStack() as stack:
            self._gl = open_gl()
            self._renderer = Renderer(self._gl, mesh)
            stack.callback(self._renderer.release)
            self.hand_over, context = agree(self._gl, report, hand_over)
            self.name = f"opengl:{self._gl.info['GL_RENDERER']}:{self.hand_over.name}:{report.name}"
            with device_errors(self.name):
                self._queue = cl.CommandQueue(context)
                self._reducer = Reducer(self._queue)
            self._bounds = Bounds(mesh)
            self._lent: tuple[int, HandOver] | None = None
            self._opened = stack.pop_all()

    def score(self, part_transforms: Transforms, log_ratio: Map) -> Floats:
        """(N, P, 3, 4) transforms, (H, W) map -> (N,) sums of the map under the silhouettes."""
        transforms = np.nan_to_num(np.ascontiguousarray(part_transforms, dtype=np.float32))
        scores = np.zeros(len(transforms))
        if max(log_ratio.shape) > (limit := self._renderer.largest_side):
            raise ImageSizeError(f"an image of {log_ratio.shape} is larger than OpenGL's textures, {limit}", limit)
        if len(transforms) == 0:
            return scores
        tiles = self._bounds.tiles(transforms, (log_ratio.shape[0], log_ratio.shape[1]))
        atlas = atlas_size(tiles, len(transforms), self._renderer.largest_side)
        each = tiles.capacity(atlas)
        with device_errors(self.name), gl_errors(self.name), self._gl:  # another scorer's context may be current
            loaded = self._reducer.load(log_ratio)
            for start in range(0, len(transforms), each):
                batch = slice(start, start + each)
                part = replace(tiles, origins=tiles.origins[batch])
                frame = self._renderer.draw(transforms[batch], part, atlas)
                used = atlas[0], -(-len(part.origins) // tiles.across(atlas[0])) * tiles.height
                with self._hand_over(atlas[0] * atlas[1]).receive(frame, used) as pixels:
                    scores[batch] = self._reducer.sums(pixels, atlas[0], part, loaded)
        return scores

    def close(self) -> None:
        """Release OpenCL's hold on OpenGL's memory first, then the context."""
        if self._lent is not None:
            with self._gl:
                self._lent[1].release()
            self._lent = None
        self._opened.close()

    def _hand_over(self, size: int) -> HandOver:
        if self._lent is None or self._lent[0] < size:
            if self._lent is not None:
                self._lent[1].release()
            self._lent = size, self._make_hand_over(size)
        return self._lent[1]

    def _make_hand_over(self, size: int) -> HandOver:
        if self.hand_over.name == "gl_sharing":
            return GlSharingHandOver(self._queue, self._gl, size)
        if self.hand_over.name == "host_shared":
            return HostSharedHandOver(self._queue, self._gl, size)
        return CopyHandOver(self._queue, size)


def agree(gl: moderngl.Context, report: DeviceReport, wanted: str | None) -> tuple[HandOverChoice, cl.Context]:
    """The hand-over that is ``wanted``, or the best one, and a context for it.

    A device that can share may still refuse to share with a context of EGL's (NVIDIA's knows GLX only): then ``copy``.
    Raises ``DeviceError`` where it refuses and sharing is wanted.
    """
    if wanted is not None:
        return HandOverChoice(wanted, "asked for"), _context(report, wanted)
    choice = choose_hand_over(cl.have_gl(), report.kind, report.extensions, has_buffer_storage(gl))
    try:
        return choice, _context(report, choice.name)
    except DeviceError as error:
        if choice.name != "gl_sharing":
            raise
        return HandOverChoice("copy", str(error)), _context(report, "copy")


def _context(report: DeviceReport, hand_over: str) -> cl.Context:
    """A context for the device; for sharing, one that knows the current OpenGL context."""
    device = open_device(report)
    if hand_over != "gl_sharing":
        with device_errors(f"opengl:{report.name}"):
            return cl.Context([device])
    context, display = current_egl()
    properties = [(cl.context_properties.PLATFORM, device.platform), (GL_CONTEXT, context), (EGL_DISPLAY, display)]
    try:
        return cl.Context(devices=[device], properties=properties)  # type: ignore[arg-type]  # its stub
    except cl.Error as error:
        raise DeviceError(f"{report.name} refuses to share with a context of EGL's: {error}") from error
