"""The jobs of decoding, one function each: bytes from outside in, checked arrays out.

Run in place for files of one's own (``skypose track``), and in a process with limits for those of clients
(``service.workers.decode_process``).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from gpu.mesh_limits import MeshError, MeshLimitError
from gpu.raw_part import RawPart
from service.errors import MeshFileError, TooLargeError
from service.imaging.decode import ByteOrder, Frame, decode_frame, decode_frames, read_facts
from service.imaging.facts import FrameFacts
from service.imaging.split import SplitFrame, frame_count, split_frames
from service.workers.limits import DecodeLimits

_MESH_SETTINGS = {
    "faces": "SKYPOSE_MAX_MODEL_FACES",
    "vertices": "SKYPOSE_MAX_MODEL_VERTICES",
    "nodes": "SKYPOSE_MAX_MODEL_NODES",
    "parts": "SKYPOSE_MAX_MODEL_PARTS",
    "joints": "SKYPOSE_MAX_MODEL_JOINTS",
    "moves": "SKYPOSE_MAX_MODEL_MOVES",
    "depth": "SKYPOSE_MAX_MODEL_DEPTH",
    "json_bytes": "SKYPOSE_MAX_MODEL_JSON_MB",
}


def past_limit(error: MeshLimitError) -> TooLargeError:
    """The same with the setting that says so."""
    setting = _MESH_SETTINGS[error.limit_name]
    return TooLargeError(str(error), field="file", limit=error.limit, found=error.found, setting=setting)


class Decoder(Protocol):
    """Every method raises ``InputError`` (its subclasses) for what is wrong with the body, and nothing else."""

    limits: DecodeLimits

    def prestart(self) -> None:
        """Begin to bring up what the first job needs, without waiting."""

    def frame(self, body: bytes, media_type: str, ser_byte_order: ByteOrder = "auto") -> Frame:
        """The one image of a file."""

    def frames(self, body: bytes, media_type: str, ser_byte_order: ByteOrder = "auto") -> Sequence[Frame]:
        """Every image of a file."""

    def split(self, body: bytes, media_type: str, ser_byte_order: ByteOrder = "auto") -> Sequence[SplitFrame]:
        """Every image of a file as a file of its own."""

    def facts(self, body: bytes, media_type: str) -> FrameFacts:
        """Time and pointing of the first image."""

    def count(self, body: bytes, media_type: str) -> int | None:
        """How many images a file holds by its header; None where it has to be decoded to know."""

    def parts(self, data: bytes, file_type: str) -> Sequence[RawPart]:
        """The parts of a mesh file."""

    def close(self) -> None:
        """Release what it holds."""


class InPlace:
    """Decodes in this process."""

    def __init__(self, limits: DecodeLimits | None = None) -> None:
        self.limits = limits or DecodeLimits()

    def prestart(self) -> None:
        """It is here already."""

    def frame(self, body: bytes, media_type: str, ser_byte_order: ByteOrder = "auto") -> Frame:
        """See ``Decoder``."""
        return decode_frame(body, media_type, limits=self.limits.image, ser_byte_order=ser_byte_order)

    def frames(self, body: bytes, media_type: str, ser_byte_order: ByteOrder = "auto") -> tuple[Frame, ...]:
        """See ``Decoder``."""
        return decode_frames(body, media_type, limits=self.limits.image, ser_byte_order=ser_byte_order)

    def split(self, body: bytes, media_type: str, ser_byte_order: ByteOrder = "auto") -> tuple[SplitFrame, ...]:
        """See ``Decoder``."""
        return split_frames(body, media_type, limits=self.limits.image, ser_byte_order=ser_byte_order)

    def facts(self, body: bytes, media_type: str) -> FrameFacts:
        """See ``Decoder``."""
        return read_facts(body, media_type, limits=self.limits.image)

    def count(self, body: bytes, media_type: str) -> int | None:
        """See ``Decoder``."""
        return frame_count(body, media_type, self.limits.image)

    def parts(self, data: bytes, file_type: str) -> list[RawPart]:
        """See ``Decoder``."""
        from gpu.mesh_file import read_parts  # a large library, which the web process never needs

        try:
            return read_parts(data, file_type, self.limits.mesh)
        except MeshLimitError as error:
            raise past_limit(error) from error
        except MeshError as error:
            raise MeshFileError(str(error), field="file") from error

    def close(self) -> None:
        """Nothing to release."""
