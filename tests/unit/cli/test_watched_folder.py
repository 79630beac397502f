"""Files are taken when they are complete, in order, once."""

import os

from service.cli.watched_folder import WatchedFolder

NOW = 1_000_000.0


def write(path, size: int, changed_s: float) -> None:
    path.write_bytes(b"x" * size)
    os.utime(path, (changed_s, changed_s))


def names(paths) -> list[str]:
    return [path.name for path in paths]


def test_old_files_are_ready_at_once_and_fresh_ones_when_they_have_settled(tmp_path):
    folder = WatchedFolder(tmp_path, 1.0)
    write(tmp_path / "a.png", 3, NOW - 10)
    write(tmp_path / "b.fits.gz", 3, NOW - 0.2)
    write(tmp_path / "c.ser", 3, NOW - 10)
    for other in ("notes.txt", ".d.png", "d.png.part"):
        write(tmp_path / other, 3, NOW - 10)
    ready = folder.ready(NOW)
    assert names(ready) == ["a.png"]  # c waits for b: frames keep their order
    folder.take(ready[0])
    assert folder.waiting == 2
    assert names(folder.ready(NOW + 1.0)) == ["b.fits.gz", "c.ser"]


def test_a_file_that_grows_is_not_complete(tmp_path):
    folder = WatchedFolder(tmp_path, 1.0)
    for k in range(4):
        write(tmp_path / "a.png", k, NOW + 0.6 * k)
        assert not folder.ready(NOW + 0.6 * k)
    # A clock that runs behind ours, as on a network share, makes no file complete while it still changes.
    write(tmp_path / "a.png", 9, NOW - 500)
    assert not folder.ready(NOW + 2.0)
    assert names(folder.ready(NOW + 3.0)) == ["a.png"]


def test_a_file_is_taken_once_and_another_of_its_name_again(tmp_path):
    folder = WatchedFolder(tmp_path, 0.0)
    write(tmp_path / "a.png", 3, NOW)
    (path,) = folder.ready(NOW)
    folder.take(path)
    assert not folder.ready(NOW + 5) and folder.waiting == 0
    write(path, 4, NOW + 6)
    assert names(folder.ready(NOW + 9)) == ["a.png"]
