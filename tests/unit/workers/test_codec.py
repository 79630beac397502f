"""Bytes of a state: bit for bit there and back, and nothing else gets in."""

import struct
import zlib
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from service.errors import CheckpointError
from service.inference.state import FilterState, Poses
from service.workers.codec import FORMAT_VERSION, decode, encode


def state(n: int = 5, n_joints: int = 2, **memory: np.ndarray) -> FilterState:
    rng = np.random.default_rng(n)
    poses = Poses(rng.normal(size=(n, 4)), rng.normal(size=(n, 2)), rng.normal(size=n), rng.normal(size=(n, n_joints)))
    rates = rng.normal(size=(n, 6 + n_joints))
    return FilterState(poses, rng.normal(size=n), rates, 7, 0.1 + 0.2, "tracking", memory)


def same(a: FilterState, b: FilterState) -> bool:
    arrays = lambda s: [s.poses.quaternion, s.poses.position, s.poses.log_scale, s.poses.joints, s.log_weights, s.rates]  # noqa: E731
    equal = all(
        x.tobytes() == y.tobytes() and x.dtype == y.dtype and x.shape == y.shape
        for x, y in zip(arrays(a), arrays(b), strict=True)
    )
    plain = (a.frame_index, a.time_s, a.status, set(a.memory)) == (b.frame_index, b.time_s, b.status, set(b.memory))
    return equal and plain and all(a.memory[k].tobytes() == b.memory[k].tobytes() for k in a.memory)


@pytest.mark.parametrize(("n", "n_joints"), [(0, 0), (1, 0), (5, 2), (1000, 3)])
def test_state_survives_bit_for_bit(n, n_joints):
    before = state(n, n_joints, seen=np.arange(3, dtype=np.int16), empty=np.zeros((0, 4)), flag=np.array(True))
    after = decode(FilterState, encode(before))
    assert same(before, after)
    assert encode(after) == encode(before)


@given(
    hnp.arrays(
        st.sampled_from([np.float32, np.float64, np.int64, np.uint8, np.bool_, np.complex64]),
        hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
    )
)
def test_any_array_survives(array):
    after = decode(FilterState, encode(state(1, 0, a=array))).memory["a"]
    assert (after.tobytes(), after.dtype, after.shape) == (array.tobytes(), array.dtype, array.shape)


def test_layout_of_memory_does_not_matter():
    array = np.arange(12.0).reshape(3, 4)
    turned = np.asfortranarray(array)
    assert encode(state(1, 0, a=array)) == encode(state(1, 0, a=turned))
    assert decode(FilterState, encode(state(1, 0, a=turned))).memory["a"].flags.c_contiguous


def test_big_endian_becomes_little():
    after = decode(FilterState, encode(state(1, 0, a=np.array([1.5], ">f8")))).memory["a"]
    assert (after[0], after.dtype.str) == (1.5, "<f8")


def test_objects_are_not_stored():
    with pytest.raises(TypeError):
        encode(state(1, 0, a=np.array([object()])))


@given(st.data())
def test_damage_is_noticed(data):
    blob = bytearray(encode(state()))
    blob[data.draw(st.integers(0, len(blob) - 1))] ^= data.draw(st.integers(1, 255))
    with pytest.raises(CheckpointError):
        decode(FilterState, bytes(blob))


@pytest.mark.parametrize("cut", [0, 3, 11, 40, -1])
def test_truncation_is_noticed(cut):
    with pytest.raises(CheckpointError):
        decode(FilterState, encode(state())[:cut])


def test_other_version_is_named():
    blob = bytearray(encode(state()))
    blob[4:6] = struct.pack("<H", FORMAT_VERSION + 1)
    with pytest.raises(CheckpointError) as refusal:
        decode(FilterState, bytes(blob))
    assert refusal.value.facts == {"format_version": FORMAT_VERSION + 1}


@given(st.binary(max_size=200))
def test_hostile_header_is_refused(header):
    body = struct.pack("<4sHHI", b"SKYP", FORMAT_VERSION, 0, len(header)) + header
    with pytest.raises(CheckpointError):
        decode(FilterState, body + struct.pack("<I", zlib.crc32(body)))


@dataclass(frozen=True)
class Old:
    a: int


@dataclass(frozen=True)
class New:
    a: int
    b: float = field(default=2.5)


def test_new_fields_take_their_default_and_unknown_ones_are_refused():
    assert decode(New, encode(Old(3))) == New(3, 2.5)
    with pytest.raises(CheckpointError, match="b"):
        decode(Old, encode(New(3)))
