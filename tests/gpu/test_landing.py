"""What kernels write and the host reads."""

from types import SimpleNamespace

import numpy as np
import pyopencl as cl
import pytest

from gpu import program
from gpu.device import first_device, open_device
from gpu.program import Kernel, landed, landing

SOURCE = "__kernel void filled(__global float *out, const int count, const float value)"
SOURCE += "{ for (int k = 0; k < count; ++k) out[k] = value + k; }"


@pytest.fixture
def queue() -> cl.CommandQueue:
    """Of the first CPU."""
    return cl.CommandQueue(cl.Context([open_device(first_device("cpu"))]))


@pytest.mark.parametrize("shared", [True, False])
def test_what_a_kernel_wrote_is_there(queue: cl.CommandQueue, shared: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a device shares its memory with the host and where it does not, also when numbers change."""
    if not shared:
        monkeypatch.setattr(program.cl, "device_svm_capabilities", SimpleNamespace(FINE_GRAIN_BUFFER=0))
    kernel = Kernel(cl.Program(queue.context, SOURCE).build(), "filled")
    for value in (3.0, 5.0):
        result = landing(queue.context, (2, 3), zeros=True)
        kernel(queue, (1,), (1,), result.argument, np.int32(4), np.float32(value))
        landed(queue, result)
        np.testing.assert_array_equal(result.values, [[value, value + 1, value + 2], [value + 3, 0, 0]])
        assert isinstance(result.argument, cl.SVM if shared else cl.Buffer)


def test_lands_where_nothing_is_asked_for(queue: cl.CommandQueue) -> None:
    """Numbers of other types, and a shape that is kept."""
    result = landing(queue.context, (4,), np.float64, zeros=True)
    assert result.values.dtype == np.float64
    assert not result.values.any()
