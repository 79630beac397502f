"""The tracker as a worker process has it."""

from __future__ import annotations

from pathlib import Path

from gpu.kernel_cache import INSTALLED, KernelCache
from service.workers.decode_process import DecodeProcess
from service.workers.kernel import hide
from service.workers.limits import DecodeLimits
from service.workers.shared_scorer import open_shared
from service.workers.tracker import Tracker
from service.workers.warm_up import build_kernels


def guarded(limits: DecodeLimits, kernels: Path | None = None, device: str | None = None) -> Tracker:
    """A tracker that is ready for its first frame, but for the decoder, which comes up when it is woken.

    What clients send is decoded in a process of its own; built kernels are kept in the folder ``kernels`` if there is
    one. ``device`` is the address of a device's owner that scores for several workers.
    """
    if limits.sandbox != "off":
        hide()  # from the decoder, too
    decoder = DecodeProcess(limits)
    cache = None if kernels is None else KernelCache(kernels, INSTALLED)
    if cache is None:
        build_kernels()
    else:
        cache.open()
        build_kernels(cache.keep)
    return Tracker(decoder, kernels=cache, opener=None if device is None else open_shared(device))
