"""Kernels that were built once are there for the next process, whole or not at all."""

import os
from pathlib import Path

import pytest

from gpu import device
from gpu.kernel_cache import KernelCache


@pytest.fixture
def caches(tmp_path, monkeypatch):
    """Caches on one folder, each opened as a process of its own would."""
    opened = []

    def open_one() -> KernelCache:
        monkeypatch.delenv("POCL_CACHE_DIR", raising=False)
        cache = KernelCache(tmp_path / "kernels")
        cache.open()
        opened.append(cache)
        return cache

    yield open_one
    for cache in opened:
        cache.close()
    monkeypatch.delenv("POCL_CACHE_DIR", raising=False)


def build(cache, name):
    """What a driver would leave behind."""
    (cache._own / "ab").mkdir(exist_ok=True)
    (cache._own / "ab" / name).write_bytes(b"code")
    (cache._own / "tempfile_x").write_bytes(b"half a ker")


def built(cache):
    return {path.name for path in cache._own.rglob("*") if path.is_file()} - {"lock"}


def test_next_process_finds_what_was_kept(caches):
    first = caches()
    assert os.environ["POCL_CACHE_DIR"] == str(first._own)
    build(first, "a.so")
    first.keep()
    second = caches()
    assert built(second) == {"a.so"}
    build(second, "b.so")
    second.keep()
    first.keep()  # has nothing new: what the second one kept stays
    assert built(caches()) == {"a.so", "b.so"}


def test_what_was_built_at_installation_is_there_for_the_first_process_of_a_service(caches, tmp_path, monkeypatch):
    installing = caches()
    build(installing, "a.so")
    installing.keep()
    monkeypatch.delenv("POCL_CACHE_DIR", raising=False)
    own = KernelCache(tmp_path / "data" / "kernels", tmp_path / "kernels")
    own.open()
    assert built(own) == {"a.so"}
    build(own, "b.so")
    own.keep()
    own.close()
    assert built(caches()) == {"a.so"}  # nobody but its owner writes to it


def test_a_process_that_keeps_none_begins_with_what_was_installed(caches, tmp_path, monkeypatch):
    installing = caches()
    build(installing, "a.so")
    installing.keep()
    installing.close()
    monkeypatch.delenv("POCL_CACHE_DIR")
    monkeypatch.setattr(device, "INSTALLED", tmp_path / "kernels")
    device._use_private_kernel_cache()
    own = Path(os.environ["POCL_CACHE_DIR"])
    assert [path.name for path in own.rglob("*.so")] == ["a.so"]
    (own / "b.so").touch()
    assert built(caches()) == {"a.so"}


def test_folders_of_the_dead_are_removed_and_those_of_the_living_are_not(caches, tmp_path):
    dead, alive = caches(), caches()
    dead._lock.close()  # as the kernel does when a process is killed
    third = caches()
    folders = {path for path in (tmp_path / "kernels").iterdir() if path.name.startswith("run-")}
    assert folders == {alive._own, third._own}


def test_choice_of_the_operator_is_left_alone(tmp_path, monkeypatch):
    monkeypatch.setenv("POCL_CACHE_DIR", "elsewhere")
    cache = KernelCache(tmp_path / "kernels")
    cache.open()
    cache.keep()
    cache.close()
    assert os.environ["POCL_CACHE_DIR"] == "elsewhere"
    assert not (tmp_path / "kernels").exists()


def test_folder_that_cannot_be_written_is_done_without(tmp_path, monkeypatch):
    monkeypatch.delenv("POCL_CACHE_DIR", raising=False)
    (tmp_path / "kernels").write_bytes(b"a file")
    cache = KernelCache(tmp_path / "kernels")
    cache.open()
    cache.keep()
    cache.close()
    assert "POCL_CACHE_DIR" not in os.environ
