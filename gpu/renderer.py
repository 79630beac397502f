"""OpenGL without a display: all particles of a batch into one atlas, one draw call per part."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import resources

import moderngl
import numpy as np
from numpy.typing import NDArray

from gpu.atlas import Tiles
from gpu.errors import DeviceError, DeviceLostError
from gpu.faces import marked_faces
from gpu.mesh import Mesh, Part

Content = list[tuple[moderngl.Buffer, str, str] | tuple[moderngl.Buffer, str, str, str]]

CLIP_DISTANCE = 0x3000


def open_gl() -> moderngl.Context:
    """A context of its own through EGL. Raises ``DeviceError``, saying why there is none."""
    try:
        return moderngl.create_context(standalone=True, require=330, backend="egl")  # type: ignore[arg-type]  # its stub
    except Exception as error:  # glcontext raises bare Exception
        raise DeviceError(f"no OpenGL 3.3 through EGL: {error}") from error


@contextmanager
def gl_errors(name: str) -> Iterator[None]:
    """Raise ``DeviceLostError`` where OpenGL fails."""
    try:
        yield
    except moderngl.Error as error:
        raise DeviceLostError(f"{name} failed: {error}") from error


class Renderer:
    """Draws silhouettes. Owned, used and released by the thread that made its context."""

    def __init__(self, gl: moderngl.Context, mesh: Mesh) -> None:
        self._gl = gl
        folder = resources.files("gpu").joinpath("shaders")
        self._program = gl.program(
            vertex_shader=folder.joinpath("silhouette.vert").read_text(),
            fragment_shader=folder.joinpath("silhouette.frag").read_text(),
        )
        self._vertices = [gl.buffer(np.ascontiguousarray(p.vertices, np.float32)) for p in mesh.parts]
        self._open, self._closed = ([self._indices(p, closed) for p in mesh.parts] for closed in (False, True))
        self._frame: moderngl.Framebuffer | None = None

    @property
    def largest_side(self) -> int:
        """Of an atlas."""
        return int(self._gl.info["GL_MAX_TEXTURE_SIZE"])

    def draw(self, transforms: NDArray[np.float32], tiles: Tiles, atlas: tuple[int, int]) -> moderngl.Framebuffer:
        """(N, P, 3, 4) transforms into their tiles of an atlas (width, height); one byte per pixel, not 0 = covered."""
        frame = self._frame_of(atlas)
        frame.use()
        frame.clear()
        self._clip(tiles.clipped)
        self._set("tile", (tiles.width, tiles.height))
        self._set("across", tiles.across(atlas[0]))
        self._set("atlas", atlas)
        origins = self._gl.buffer(tiles.origins.astype(np.float32))
        for part, vertices in enumerate(self._vertices):
            rows = self._gl.buffer(np.ascontiguousarray(transforms[:, part, :2], np.float32))
            content: Content = [
                (vertices, "3f", "position"),
                (rows, "4f 4f/i", "to_x", "to_y"),
                (origins, "2f/i", "origin"),
            ]
            self._render(self._open[part], content, len(transforms))
            self._gl.enable(moderngl.CULL_FACE)  # of a closed piece, either half of the faces is enough
            self._render(self._closed[part], content, len(transforms))
            self._gl.disable(moderngl.CULL_FACE)
            rows.release()
        origins.release()
        return frame

    def release(self) -> None:
        """Give everything back, the context too."""
        self._gl.release()

    def _indices(self, part: Part, closed: bool) -> moderngl.Buffer | None:
        faces = marked_faces(part)
        chosen = faces[(faces[:, 3] != 0) == closed, :3]
        return self._gl.buffer(np.ascontiguousarray(chosen)) if len(chosen) else None

    def _render(self, indices: moderngl.Buffer | None, content: Content, instances: int) -> None:
        if indices is not None:
            array = self._gl.vertex_array(self._program, content, indices)
            array.render(moderngl.TRIANGLES, instances=instances)
            array.release()

    def _set(self, uniform: str, value: int | tuple[int, int]) -> None:
        member = self._program[uniform]
        if not isinstance(member, moderngl.Uniform):
            raise DeviceError(f"OpenGL's compiler made {uniform} a {type(member).__name__}")
        member.value = value

    def _clip(self, wanted: bool) -> None:
        """Clipping costs a software renderer several times the rest, and is only needed at the image's borders."""
        for k in range(4):
            (self._gl.enable_direct if wanted else self._gl.disable_direct)(CLIP_DISTANCE + k)

    def _frame_of(self, atlas: tuple[int, int]) -> moderngl.Framebuffer:
        if self._frame is None or self._frame.size != atlas:
            if self._frame is not None:
                self._frame.color_attachments[0].release()
                self._frame.release()
            self._frame = self._gl.framebuffer([self._gl.texture(atlas, 1)])
        return self._frame
