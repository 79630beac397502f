"""Files in the order in which people count them."""

from pathlib import Path

import pytest

from service.remote.media import frames_in, in_order


@pytest.mark.parametrize(
    "names",
    [
        ["frame_2.png", "frame_10.png", "frame_100.png"],
        ["099.png", "100.png", "1000.png"],
        ["a_2.fits", "a_10.fits", "b_1.fits"],
        ["2026-11-30T23_59.png", "2026-12-01T00_00.png"],
        ["7.png", "sky.png"],
    ],
)
def test_numbers_count_by_their_size(names):
    assert [path.name for path in in_order(Path(name) for name in reversed(names))] == names


def test_a_folders_images_in_order(tmp_path):
    for name in ("10.png", "9.png", "notes.txt", "11.ser"):
        (tmp_path / name).touch()
    assert [path.name for path in frames_in(tmp_path)] == ["9.png", "10.png", "11.ser"]
