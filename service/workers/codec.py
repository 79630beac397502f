"""Dataclasses of arrays as bytes, and back bit for bit.

Layout, all little-endian: ``b"SKYP"``, format version (u16), zero (u16), header length (u32), header (JSON),
the arrays' raw C-ordered bytes one after the other, CRC-32 of all before it (u32). The header names each
array's dtype and shape and holds the tree of fields. No pickle: a checkpoint comes from outside.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import struct
import types
import typing
import zlib
from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from service.errors import CheckpointError

T = TypeVar("T")

FORMAT_VERSION = 1
_MAGIC = b"SKYP"
_PREFIX = struct.Struct("<4sHHI")
_KINDS = "biufc"
_MOST_HEADER = 1 << 20  # a state's is a thousandth of that


def encode(value: object) -> bytes:
    """A dataclass instance (nested ones, arrays, mappings of arrays, numbers, text) as bytes."""
    arrays: list[NDArray[Any]] = []
    tree = _pack(value, arrays)
    specs = [{"dtype": a.dtype.str, "shape": list(a.shape)} for a in arrays]
    header = json.dumps({"tree": tree, "arrays": specs}, separators=(",", ":")).encode()
    parts = [_PREFIX.pack(_MAGIC, FORMAT_VERSION, 0, len(header)), header, *(a.tobytes() for a in arrays)]
    blob = b"".join(parts)
    return blob + struct.pack("<I", zlib.crc32(blob))


def decode(kind: type[T], blob: bytes) -> T:
    """The instance of dataclass ``kind`` that ``encode`` turned into ``blob``.

    Raises ``CheckpointError`` for damaged bytes, another format version, or fields that ``kind`` lacks.
    """
    header, offset = _read_header(blob)
    try:
        arrays = _read_arrays(header["arrays"], memoryview(blob)[offset:-4])
        return typing.cast(T, _unpack(header["tree"], kind, arrays))
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError, RecursionError) as error:
        raise CheckpointError(f"the stored fields do not fit {kind.__name__}: {error}") from error


def _read_header(blob: bytes) -> tuple[dict[str, Any], int]:
    if len(blob) < _PREFIX.size + 4:
        raise CheckpointError("too short")
    magic, version, _, length = _PREFIX.unpack_from(blob)
    if magic != _MAGIC:
        raise CheckpointError("does not begin with the format's mark")
    if version != FORMAT_VERSION:
        raise CheckpointError(f"format version {version}; this release reads {FORMAT_VERSION}", format_version=version)
    if zlib.crc32(memoryview(blob)[:-4]) != struct.unpack("<I", blob[-4:])[0]:
        raise CheckpointError("damaged: the checksum does not match")
    if length > _MOST_HEADER:
        raise CheckpointError("damaged header")
    try:
        header = json.loads(blob[_PREFIX.size : _PREFIX.size + length])
    except (ValueError, RecursionError) as error:
        raise CheckpointError("damaged header") from error
    if not isinstance(header, dict):
        raise CheckpointError("damaged header")
    return header, _PREFIX.size + length


def _read_arrays(specs: list[dict[str, Any]], data: memoryview) -> list[NDArray[Any]]:
    arrays: list[NDArray[Any]] = []
    offset = 0
    for spec in specs:
        dtype = _dtype(str(spec["dtype"]))
        shape = tuple(int(n) for n in spec["shape"])
        count = math.prod(shape)
        if min(shape, default=0) < 0 or offset + count * dtype.itemsize > len(data):
            raise ValueError("arrays reach past the end")
        # A copy in NumPy's own memory: writable, and aligned like any other array.
        arrays.append(np.frombuffer(data, dtype, count, offset).reshape(shape).copy())
        offset += count * dtype.itemsize
    if offset != len(data):
        raise ValueError("bytes left over after the arrays")
    return arrays


@functools.lru_cache(64)
def _dtype(name: str) -> np.dtype[Any]:
    dtype = np.dtype(name)
    if dtype.kind not in _KINDS:
        raise ValueError(f"dtype {dtype} is not allowed")
    return dtype


def _pack(value: object, arrays: list[NDArray[Any]]) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = dataclasses.fields(value)
        return {"fields": {f.name: _pack(getattr(value, f.name), arrays) for f in fields}}
    if isinstance(value, np.ndarray):
        arrays.append(_portable(value))
        return {"array": len(arrays) - 1}
    if isinstance(value, Mapping):
        return {"map": {str(key): _pack(item, arrays) for key, item in value.items()}}
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return {"float": value.hex()}
    if value is None or isinstance(value, bool | int | str):
        return value
    raise TypeError(f"{type(value).__name__} cannot be stored")


def _portable(array: NDArray[Any]) -> NDArray[Any]:
    if array.dtype.kind not in _KINDS:
        raise TypeError(f"arrays of {array.dtype} cannot be stored")
    return np.asarray(array, dtype=array.dtype.newbyteorder("<"), order="C")


def _unpack(node: Any, hint: Any, arrays: list[NDArray[Any]]) -> Any:
    if not isinstance(node, dict):
        return node
    ((tag, body),) = node.items()
    if tag == "array":
        return arrays[body]
    if tag == "float":
        return float.fromhex(body)
    if tag == "map":
        inner = (typing.get_args(hint) or (str, None))[-1]
        return {key: _unpack(item, inner, arrays) for key, item in body.items()}
    if isinstance(hint, types.UnionType):  # what may be None, and is not
        (hint,) = (kind for kind in typing.get_args(hint) if kind is not types.NoneType)
    hints = _hints_of(hint)
    unknown = body.keys() - hints.keys()
    if tag != "fields" or unknown:
        raise ValueError(f"unknown: {', '.join(sorted(unknown)) or tag}")
    return hint(**{name: _unpack(item, hints[name], arrays) for name, item in body.items()})


@functools.cache
def _hints_of(kind: type) -> Mapping[str, Any]:
    """The types of a dataclass's fields: as texts they are read anew each time, which takes half a millisecond."""
    hints = typing.get_type_hints(kind)
    return {one.name: hints[one.name] for one in dataclasses.fields(kind)}
