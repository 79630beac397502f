"""The step's random numbers: known answers, a twin in NumPy, and their law."""

from importlib import resources

import numpy as np
import pyopencl as cl
import pytest
from scipy import stats
from step_cases import LEAST_P, Case


@pytest.fixture(scope="module")
def case():
    return Case()


def twin_of_philox(counter, key):
    """Philox4x32-10 of (N, 4) counters and (N, 2) keys, from the paper's definition."""
    (a, b, c, d), (k, m) = counter.astype(np.uint64).T, key.astype(np.uint64).T
    low = np.uint64(0xFFFFFFFF)
    for _ in range(10):
        first, second = a * np.uint64(0xD2511F53), c * np.uint64(0xCD9E8D57)
        a, b, c, d = (second >> 32) ^ b ^ k, second & low, (first >> 32) ^ d ^ m, first & low
        k, m = (k + np.uint64(0x9E3779B9)) & low, (m + np.uint64(0xBB67AE85)) & low
    return np.stack([a, b, c, d], axis=1).astype(np.uint32)


def on_device(case, kernel, name, out, *inputs):
    """Run one of this file's own kernels over the rows of ``out``."""
    source = resources.files("gpu").joinpath("kernels/step_random.cl").read_text() + kernel
    queue = case.step._queue
    program = cl.Program(queue.context, source).build()
    flags = cl.mem_flags.COPY_HOST_PTR
    buffers = [cl.Buffer(queue.context, flags, hostbuf=np.ascontiguousarray(a)) for a in (*inputs, out)]
    cl.Kernel(program, name)(queue, (len(out),), None, *buffers)
    cl.enqueue_copy(queue, out, buffers[-1])
    return out


def philox_on_device(case, counter, key):
    kernel = """__kernel void numbers(__global const uint4 *counter, __global const uint2 *key, __global uint4 *out)
    { const int i = get_global_id(0); out[i] = philox(counter[i], key[i]); }"""
    return on_device(case, kernel, "numbers", np.zeros((len(counter), 4), np.uint32), counter, key)


def test_known_answers_of_random123(case):
    counter = np.array([[0] * 4, [0xFFFFFFFF] * 4, [0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344]], np.uint32)
    key = np.array([[0] * 2, [0xFFFFFFFF] * 2, [0xA4093822, 0x299F31D0]], np.uint32)
    expected = [
        [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8],
        [0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD],
        [0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1],
    ]
    assert np.array_equal(philox_on_device(case, counter, key), expected)


def test_generator_is_its_numpy_twin(case):
    rng = np.random.default_rng(0)
    counter = rng.integers(0, 2**32, (4096, 4), dtype=np.uint32)
    key = rng.integers(0, 2**32, (4096, 2), dtype=np.uint32)
    assert np.array_equal(philox_on_device(case, counter, key), twin_of_philox(counter, key))


def test_normal_numbers_are_normal_and_independent(case):
    kernel = """__kernel void gauss(__global float4 *out)
    { const int i = get_global_id(0); out[i] = normals(draw(5, 3, FOR_MOTION, i, 0)); }"""
    values = on_device(case, kernel, "gauss", np.zeros((200_000, 4), np.float32))
    assert all(stats.kstest(column, "norm").pvalue > LEAST_P for column in values.T)
    assert np.abs(np.corrcoef(values.T) - np.eye(4)).max() < 5 / np.sqrt(len(values))
    assert np.abs(np.corrcoef((values**2).T) - np.eye(4)).max() < 5 / np.sqrt(len(values))
