"""Messages of the decode process. What comes back from it is JSON and raw arrays, never pickle: it has read bytes
from outside with large libraries, and is not trusted.

A message is its length (u64, little-endian) and so many bytes. A reply is a JSON message, then one of raw bytes for
each array it lists.
"""

from __future__ import annotations

import json
import math
import socket
import struct
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpu.raw_part import RawPart
from service.imaging.decode import Frame
from service.imaging.facts import FrameFacts
from service.imaging.split import SplitFrame

OUT_OF_MEMORY = 77  # exit status of the process
_LENGTH = struct.Struct("<Q")
_DTYPES = ("|u1", "<u2", "<f8", "<i8")
_REPLY_BYTES = 1 << 26  # JSON of ten thousand frames' facts is two


@dataclass(frozen=True)
class Reply:
    """Plain JSON values, and the arrays that go with them."""

    value: Any
    arrays: Sequence[NDArray[Any]] = ()


def send(channel: socket.socket, *buffers: Any) -> None:
    """Send one message in pieces."""
    views = [memoryview(buffer).cast("B") for buffer in buffers]
    channel.sendall(_LENGTH.pack(sum(view.nbytes for view in views)))
    for view in views:
        if view.nbytes:
            channel.sendall(view)


def receive(channel: socket.socket, most: int, until: float | None = None) -> bytearray:
    """One message. Raises ``EOFError`` at the end of the stream, ``TimeoutError`` past ``until`` (monotonic)."""
    (size,) = _LENGTH.unpack(_exactly(channel, bytearray(_LENGTH.size), until))
    if size > most:
        raise ValueError(f"a message of {size} bytes; at most {most} were expected")
    return _exactly(channel, bytearray(size), until)


def receive_bytes(channel: socket.socket) -> bytes:
    """One message of any size, in one piece of memory. Raises as ``receive`` does."""
    (size,) = _LENGTH.unpack(_exactly(channel, bytearray(_LENGTH.size), None))
    data = channel.recv(size, socket.MSG_WAITALL) if size else b""
    if len(data) < size:
        raise EOFError
    return data


def _exactly(channel: socket.socket, buffer: bytearray, until: float | None) -> bytearray:
    view, at = memoryview(buffer), 0
    while at < len(buffer):
        if until is not None:
            channel.settimeout(max(until - time.monotonic(), 1e-3))
        count = channel.recv_into(view[at:])
        if count == 0:
            raise EOFError
        at += count
    return buffer


def send_reply(channel: socket.socket, reply: Reply) -> None:
    """Send a reply."""
    arrays = [np.ascontiguousarray(array) for array in reply.arrays]
    specs = [[array.dtype.str, array.shape] for array in arrays]
    send(channel, json.dumps({"value": reply.value, "arrays": specs}).encode())
    for array in arrays:
        send(channel, array.reshape(-1).view(np.uint8))


def receive_reply(channel: socket.socket, most: int, until: float) -> Reply:
    """A reply with arrays of at most ``most`` bytes together. Raises ``ValueError`` for what is none."""
    head = json.loads(receive(channel, _REPLY_BYTES, until))
    arrays: list[NDArray[Any]] = []
    for name, shape in head["arrays"]:
        if name not in _DTYPES or not all(isinstance(n, int) and n >= 0 for n in shape):
            raise ValueError(f"an array of {name} {shape}")
        size = math.prod(shape) * np.dtype(name).itemsize
        most -= size
        if most < 0:
            raise ValueError("larger than any decoded file may be")
        arrays.append(np.frombuffer(receive(channel, size, until), name).reshape(shape))
    return Reply(head["value"], arrays)


def pack_frames(frames: Sequence[Frame]) -> Reply:
    """Frames as a reply; ``unpack_frames`` undoes it."""
    return Reply([_facts_out(frame.facts) for frame in frames], [frame.image for frame in frames])


def unpack_frames(reply: Reply) -> tuple[Frame, ...]:
    """Frames out of a reply. Raises ``ValueError`` for what are no images."""
    return tuple(_frame(image, facts) for image, facts in zip(reply.arrays, reply.value, strict=True))


def pack_split(frames: Sequence[SplitFrame]) -> Reply:
    """Single files as a reply."""
    bodies = [np.frombuffer(frame.body, np.uint8) for frame in frames]
    return Reply([_facts_out(frame.facts) for frame in frames], bodies)


def unpack_split(reply: Reply) -> tuple[SplitFrame, ...]:
    """Single files out of a reply."""
    found = zip(reply.arrays, reply.value, strict=True)
    return tuple(SplitFrame(array.tobytes(), unpack_facts(facts)) for array, facts in found)


def pack_parts(parts: Sequence[RawPart]) -> Reply:
    """A mesh's parts as a reply."""
    return Reply([part.name for part in parts], [a for part in parts for a in (part.vertices, part.faces)])


def unpack_parts(reply: Reply) -> list[RawPart]:
    """A mesh's parts out of a reply."""
    pairs = zip(reply.arrays[::2], reply.arrays[1::2], strict=True)
    return [RawPart(str(name), *pair) for name, pair in zip(reply.value, pairs, strict=True)]


def pack_facts(facts: FrameFacts) -> Reply:
    """Time and pointing as a reply."""
    return Reply(_facts_out(facts))


def unpack_facts(value: dict[str, Any] | None) -> FrameFacts:
    """Time and pointing out of a reply's value."""
    given = dict(value or {})
    if given.get("time") is not None:
        given["time"] = datetime.fromisoformat(given["time"])
    return FrameFacts(**given)


def _facts_out(facts: FrameFacts) -> dict[str, Any] | None:
    given = {name: value for name, value in asdict(facts).items() if value is not None}
    if facts.time is not None:
        given["time"] = facts.time.isoformat()
    return given or None


def _frame(image: NDArray[Any], facts: dict[str, Any] | None) -> Frame:
    if image.dtype.kind != "u" or not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)):
        raise ValueError(f"{image.dtype} {image.shape} is no image")
    return Frame(image, image.dtype.itemsize * 8, 1 if image.ndim == 2 else 3, unpack_facts(facts))
