"""How large a mesh file may be in every respect that costs memory or time."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MeshLimits:
    """Limits of one mesh file, as far as they can be read from it before it is parsed, and again afterwards."""

    faces: int = 1_000_000
    vertices: int = 3_000_000
    nodes: int = 10_000
    parts: int = 512  # nodes that carry triangles: every particle has a transform for each
    joints: int = 64
    moves: int = 20_000  # parts that joints move, each as often as a stage of a joint moves it
    depth: int = 64  # levels of nodes below each other
    json_bytes: int = 1 << 24  # of a GLB's JSON chunk


class MeshError(ValueError):
    """The file is no usable mesh; the message says why."""


class MeshLimitError(MeshError):
    """The file is past a limit: ``limit_name`` of ``MeshLimits``, with what was ``found``."""

    def __init__(self, limit_name: str, found: int, limit: int) -> None:
        super().__init__(f"{found} {limit_name.replace('_', ' ')}: more than the limit of {limit}")
        self.limit_name, self.found, self.limit = limit_name, found, limit


def require(limits: MeshLimits, **found: int) -> None:
    """Raises ``MeshLimitError`` for the first of ``found`` past its limit."""
    for name, count in found.items():
        if count > (limit := int(getattr(limits, name))):
            raise MeshLimitError(name, count, limit)
