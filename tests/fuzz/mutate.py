"""Ways to spoil bytes. Everything is drawn from one generator, so a seed and a number repeat an input."""

import copy
import hashlib
import json
import random
import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from gpu.urdf_archive import pack_urdf, unpack_urdf
from service.sessions.checkpoint import Checkpoint
from service.sessions.checkpoint_models import Compared
from service.workers.codec import decode, encode

NUMBERS = (0, 1, 2, 3, 7, 8, 15, 16, 127, 128, 255, 256, 4095, 32767, 65535, 65536, 1 << 20, 1 << 24, 1 << 31, 1 << 32)
VALUES: tuple[Any, ...] = (
    *(None, True, -1, 0, 1, 1e308, -1e308, 1e-320, 2**31, 2**53, 2**63, 2**64, 10**400, "", "x", "\0", "é", "9" * 400),
    *([], {}, [[]], [{}], [0] * 50, {"x": 1}, "2026-11-20T03:04:05Z", "NaN", "../../etc/passwd", "a" * 5000),
    *("9999-12-31T23:59:59-23:59", "0001-01-01T00:00:00+23:59", "auto", "all", [0, 0, 0], [1e308] * 3, 0.5, 45.0),
)


def spoil(dice: random.Random, body: bytes, other: bytes) -> bytes:
    """``body`` after one to four changes; ``other`` is a body to take pieces from."""
    data = bytearray(body)
    for _ in range(dice.choice((1, 1, 1, 2, 2, 3, 4))):
        dice.choice(_CHANGES)(dice, data, other)
    return bytes(data)


def _flip(dice: random.Random, data: bytearray, _: bytes) -> None:
    for _n in range(dice.choice((1, 1, 2, 8, 64))):
        if data:
            data[_place(dice, data)] ^= 1 << dice.randrange(8)


def _set(dice: random.Random, data: bytearray, _: bytes) -> None:
    if data:
        data[_place(dice, data)] = dice.choice((0, 1, 0x7F, 0x80, 0xFF, 0x20, 0x30, dice.randrange(256)))


def _number(dice: random.Random, data: bytearray, _: bytes) -> None:
    """A number that hurts, in any width and order."""
    form = dice.choice(("<B", "<H", ">H", "<I", ">I", "<Q", ">Q"))
    size = struct.calcsize(form)
    value = (dice.choice(NUMBERS) * dice.choice((1, 1, -1)) + dice.choice((0, 0, 1, -1))) % (1 << (8 * size))
    if len(data) >= size:
        at = min(_place(dice, data), len(data) - size)
        data[at : at + size] = struct.pack(form, value)


def _digits(dice: random.Random, data: bytearray, _: bytes) -> None:
    """Another number in a text header."""
    places = [k for k in range(min(len(data), 6000)) if 48 <= data[k] <= 57]
    if places:
        at = dice.choice(places)
        new = dice.choice((b"-1", b"0", b"99999999", b"1e999", b"nan", b"4294967296", b"2147483647"))
        data[at : at + len(new)] = new


def _cut(dice: random.Random, data: bytearray, _: bytes) -> None:
    del data[_place(dice, data) :]


def _drop(dice: random.Random, data: bytearray, _: bytes) -> None:
    at = _place(dice, data)
    del data[at : at + dice.choice((1, 2, 4, 16, 80, 512, 2880))]


def _repeat(dice: random.Random, data: bytearray, _: bytes) -> None:
    at, size = _place(dice, data), dice.choice((1, 4, 16, 80, 512, 2880))
    data[at:at] = data[at : at + size] * dice.choice((1, 1, 3, 40))


def _insert(dice: random.Random, data: bytearray, _: bytes) -> None:
    at = _place(dice, data)
    data[at:at] = dice.randbytes(dice.choice((1, 2, 4, 64, 1000)))


def _splice(dice: random.Random, data: bytearray, other: bytes) -> None:
    if other:
        start, at = dice.randrange(len(other)), _place(dice, data)
        piece = other[start : start + dice.choice((4, 64, 512, 4096))]
        data[at : at + len(piece)] = piece


def _place(dice: random.Random, data: bytearray) -> int:
    """Anywhere, but every second time in the head, where the numbers are."""
    if not data:
        return 0
    return dice.randrange(min(len(data), 300) if dice.random() < 0.5 else len(data))


_CHANGES: tuple[Callable[[random.Random, bytearray, bytes], None], ...] = (
    *(_flip, _flip, _set, _number, _number, _number, _digits, _digits),
    *(_cut, _drop, _repeat, _insert, _splice),
)


def mend_png(body: bytes) -> bytes:
    """Right checksums in every chunk, so that a spoilt file gets past them."""
    out, at = bytearray(body[:8]), 8
    while at + 12 <= len(body):
        length = int.from_bytes(body[at : at + 4], "big")
        end = at + 8 + length
        if end + 4 > len(body):
            break
        out += body[at:end] + zlib.crc32(body[at + 4 : end]).to_bytes(4, "big")
        at = end + 4
    return bytes(out) + body[at:]


def mend_glb(dice: random.Random, body: bytes) -> bytes:
    """A GLB whose JSON is changed as JSON, with right lengths."""
    length = struct.unpack_from("<I", body, 12)[0]
    tree = spoil_json(dice, json.loads(body[20 : 20 + length]))
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    rest = body[20 + length :]
    return struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest


def mend_urdf(dice: random.Random, body: bytes) -> bytes:
    """A robot whose document or one of whose meshes is spoilt, in an archive that is well."""
    document, meshes = unpack_urdf(body)
    name = dice.choice(["", *sorted(meshes)])
    if not name:
        return pack_urdf(spoil(dice, document, body), meshes)
    return pack_urdf(document, {**meshes, name: spoil(dice, meshes[name], document)})


def spoil_json(dice: random.Random, tree: Any) -> Any:
    """Another value at one to three places of a tree, or a key too many or too few."""
    for _ in range(dice.choice((1, 1, 2, 3))):
        places = list(_places(tree))
        if not places:
            return _value(dice)
        holder, key = dice.choice(places)
        if isinstance(holder, dict) and dice.random() < 0.15:
            del holder[key]
        elif isinstance(holder, dict) and dice.random() < 0.1:
            holder[dice.choice(("x", "", "__class__", "id", "number", "tenant"))] = _value(dice)
        elif isinstance(holder, list) and dice.random() < 0.2:
            holder.insert(key, holder[key])
        else:
            holder[key] = _value(dice) if dice.random() < 0.7 else _nudged(dice, holder[key])
    return tree


def _value(dice: random.Random) -> Any:
    return copy.deepcopy(dice.choice(VALUES))


def _nudged(dice: random.Random, value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return _value(dice)
    return dice.choice((-value, value + 1, value - 1, value * 10**6, value * 0, value / 3 if abs(value) < 1e300 else 0))


def _places(tree: Any):
    if isinstance(tree, dict | list):
        for key, value in list(tree.items() if isinstance(tree, dict) else enumerate(tree)):
            yield tree, key
            yield from _places(value)


def forge(dice: random.Random, blob: bytes) -> bytes:
    """A checkpoint with one of its parts changed, and a right checksum: what only a reader of the content finds."""
    if dice.random() < 0.1:
        return reseal(spoil(dice, blob, blob))
    packed = decode(Checkpoint, blob)
    if packed.compared is not None and dice.random() < 0.6:
        return encode(replace(packed, compared=forge_models(dice, packed.compared)))
    parts = {
        name: getattr(packed, name).tobytes()
        for name in Checkpoint.__dataclass_fields__
        if name != "compared" and len(getattr(packed, name))
    }
    name = dice.choice(list(parts))
    if name in ("session", "model", "history") and dice.random() < 0.85:
        parts[name] = json.dumps(spoil_json(dice, json.loads(parts[name]))).encode()
    elif name == "state" and dice.random() < 0.9:
        parts[name] = forge_arrays(dice, parts[name])
    else:
        parts[name] = spoil(dice, parts[name], parts["state"])
    if name == "background" and dice.random() < 0.8:  # the right hash, so that it is read
        session = json.loads(parts["session"])
        session["background_key"] = _sha256(parts["background"])
        parts["session"] = json.dumps(session).encode()
    return encode(replace(packed, **{key: np.frombuffer(value, np.uint8) for key, value in parts.items()}))


def forge_models(dice: random.Random, compared: Compared) -> Compared:
    """The models of a comparison, one of their rows, files or posteriors changed, left out, or another's."""
    if dice.random() < 0.4:
        rows = json.dumps(spoil_json(dice, json.loads(compared.rows.tobytes()))).encode()
        return replace(compared, rows=np.frombuffer(rows, np.uint8))
    name = dice.choice(("files", "states"))
    parts = dict(getattr(compared, name))
    key, kind = dice.choice(sorted(parts)), dice.random()
    if kind < 0.2:
        parts[dice.choice(("7", "x", "-1"))] = parts.pop(key)
    elif kind < 0.4:
        parts[key] = parts[dice.choice(sorted(parts))]
    else:
        body = parts[key].tobytes()
        changed = forge_arrays(dice, body) if name == "states" else spoil(dice, body, body)
        parts[key] = np.frombuffer(changed, np.uint8)
    return replace(compared, **{name: parts})


def forge_arrays(dice: random.Random, blob: bytes) -> bytes:
    """A packed state with another number, shape, type or name in it, and a right checksum."""
    length = struct.unpack_from("<I", blob, 8)[0]
    header, data = json.loads(blob[12 : 12 + length]), bytearray(blob[12 + length : -4])
    if dice.random() < 0.5:
        header = spoil_json(dice, header)
    else:
        for _ in range(dice.choice((1, 1, 5))):
            at = dice.randrange(max(len(data) - 8, 1)) // 8 * 8
            value = dice.choice((float("nan"), float("inf"), -float("inf"), 1e300, -1e300, 1e-320, 0.0, 50.0, -3.0))
            data[at : at + 8] = struct.pack("<d", value)
    text = json.dumps(header).encode()
    return reseal(blob[:8] + struct.pack("<I", len(text)) + text + bytes(data) + b"0000")


def reseal(blob: bytes) -> bytes:
    """The blob with a right checksum at its end."""
    return blob[:-4] + struct.pack("<I", zlib.crc32(blob[:-4]))


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
