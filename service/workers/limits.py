"""What a worker may spend on bytes from outside. Plain data, handed to every worker process at its start."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from gpu.mesh_limits import MeshLimits
from service.imaging.limits import ImageLimits


@dataclass(frozen=True)
class DecodeLimits:
    """Limits of the decode process, beside those of the files themselves. docs/settings.md has the settings."""

    memory_bytes: int = 2 << 30  # beyond what the process takes before its first job
    cpu_s: int = 20  # of one job
    timeout_s: float = 60.0  # of one job, on a machine that is busy with other things
    sandbox: Literal["auto", "required", "off"] = "auto"  # what the process gives up beside (``sandbox``)
    image: ImageLimits = field(default_factory=ImageLimits)
    mesh: MeshLimits = field(default_factory=MeshLimits)

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> DecodeLimits:
        """The limits that the process's settings name."""
        return cls(
            memory_bytes=settings["decode_memory_mb"] << 20,
            cpu_s=settings["decode_cpu_s"],
            timeout_s=settings["decode_timeout_s"],
            sandbox=settings["decode_sandbox"],
            image=ImageLimits(
                pixels=settings["max_image_pixels"],
                frames=settings["max_image_frames"],
                ratio=settings["max_image_ratio"],
                header_bytes=settings["max_header_kb"] << 10,
            ),
            mesh=MeshLimits(
                faces=settings["max_model_faces"],
                vertices=settings["max_model_vertices"],
                nodes=settings["max_model_nodes"],
                parts=settings["max_model_parts"],
                joints=settings["max_model_joints"],
                moves=settings["max_model_moves"],
                depth=settings["max_model_depth"],
                json_bytes=settings["max_model_json_mb"] << 20,
            ),
        )
