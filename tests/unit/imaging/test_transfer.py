"""Counts that a camera has stretched become light again."""

import numpy as np
import pytest

from service.errors import ConfigError
from service.imaging.frame import as_frame
from service.imaging.transfer import linear
from service.sessions.config import effective

LIGHT = np.linspace(0, 1, 4096).reshape(64, 64)


@pytest.mark.parametrize("power", [0.45, 0.5, 2.0])
@pytest.mark.parametrize("top", [255, 65535])
def test_a_power_is_taken_back(power, top):
    counts = np.rint(LIGHT**power * top).astype(np.uint8 if top == 255 else np.uint16)
    found = linear(as_frame(counts), power)
    assert (found.bits, found.image.dtype) == (16, np.uint16)
    low, high = (
        np.clip(counts.astype(float) + side, 0, top) / top for side in (-0.5, 0.5)
    )  # what is rounded to the same count
    assert (found.image >= low ** (1 / power) * 65535 - 1).all()
    assert (found.image <= high ** (1 / power) * 65535 + 1).all()


def test_srgb_is_taken_back_in_colour_and_full_scale_stays():
    stretched = np.where(LIGHT <= 0.0031308, 12.92 * LIGHT, 1.055 * LIGHT ** (1 / 2.4) - 0.055)
    counts = np.rint(np.stack([stretched] * 3, axis=-1) * 65535).astype(np.uint16)
    found = linear(as_frame(counts), "srgb")
    assert found.channels == 3 and found.image.max() == 65535
    assert np.abs(found.image / 65535 - LIGHT[..., None]).max() < 1e-4


def test_what_is_linear_stays_as_it_is():
    frame = as_frame(np.arange(256, dtype=np.uint8).reshape(16, 16))
    assert linear(frame, "linear") is frame and linear(frame, 1.0) is frame


@pytest.mark.parametrize("wrong", ["gamma", 0.0, -1.0, 100.0])
def test_other_transfers_are_refused(wrong):
    with pytest.raises(ConfigError, match="transfer"):
        effective({"camera": {"transfer": wrong}})
    assert effective({"camera": {"transfer": 0.45}}).camera.transfer == 0.45
