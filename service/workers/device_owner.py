"""The process that owns a device for several workers: what they ask at one time is one kernel launch.

There is no waiting for more questions: while the device works on some, others arrive, and are the next launch.
"""

from __future__ import annotations

import pickle
import selectors
import socket
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from gpu.batch import BatchOutline, Question
from gpu.device import DeviceReport, find_devices
from gpu.errors import DeviceError, DeviceLostError, ScorerError
from gpu.mesh import Mesh

MOST_BYTES = 64 << 20  # of one launch's transforms


@dataclass
class _Guest:
    """A worker's scorer."""

    channel: Connection
    model: str = ""
    outline: BatchOutline | None = None
    slot: int = -1


@dataclass(frozen=True)
class _Asked:
    guest: _Guest
    outline: BatchOutline
    transforms: NDArray[np.float32]


class DeviceOwner:
    """Answers the scorers that connect to a listening socket. One thread."""

    def __init__(self, listener: socket.socket, report: DeviceReport) -> None:
        self.name = f"opencl:outline:{report.name}"
        self.questions = self.launches = 0  # so far
        self._listener, self._report = listener, report
        self._ready = selectors.DefaultSelector()
        self._ready.register(listener, selectors.EVENT_READ, None)
        self._outlines: WeakValueDictionary[str, BatchOutline] = WeakValueDictionary()  # while a guest uses them

    def turn(self) -> None:
        """Wait for messages and answer all that there are. Raises ``DeviceLostError``, after those who asked heard."""
        asked: list[_Asked] = []
        for key, _ in self._ready.select():
            if key.data is None:
                end, _ = self._listener.accept()
                channel = Connection(end.detach())
                self._ready.register(channel, selectors.EVENT_READ, _Guest(channel))
            else:
                asked += self._hear(key.data)
        for together in _launches(asked):
            self._answer(together)

    def _hear(self, guest: _Guest) -> list[_Asked]:
        """A guest's message: what it asks to be scored, or nothing more to do."""
        try:
            kind, *rest = pickle.loads(guest.channel.recv_bytes())
        except (EOFError, OSError):
            self._part(guest)
            return []
        if kind == "score" and guest.outline is not None:
            prefix, transforms = rest
            if prefix is not None:
                guest.outline.put(guest.slot, prefix)
            return [_Asked(guest, guest.outline, transforms)]
        try:
            self._reply(guest, None, self._open(guest, *rest))
        except ScorerError as error:
            self._reply(guest, error, None)
        return []

    def _open(self, guest: _Guest, model: str | Mesh) -> str | None:
        """Of the model with this key the scorer's name; None where its mesh must be sent first."""
        if isinstance(model, str):
            guest.model = model
            outline = self._outlines.get(model)
            if outline is None:
                return None
        else:
            outline = self._outlines.setdefault(guest.model, BatchOutline(model, self._report))
        guest.outline, guest.slot = outline, outline.take_slot()
        return outline.name

    def _answer(self, together: Sequence[_Asked]) -> None:
        outline = together[0].outline
        self.questions += len(together)
        try:
            scores = outline.score([Question(one.guest.slot, one.transforms) for one in together])
        except ScorerError as error:
            for one in together:
                self._reply(one.guest, error, None)
            if isinstance(error, DeviceLostError):
                raise
            return
        self.launches += 1
        for one, answer in zip(together, scores, strict=True):
            self._reply(one.guest, None, answer)

    def _reply(self, guest: _Guest, error: ScorerError | None, answer: object) -> None:
        try:
            guest.channel.send_bytes(pickle.dumps((error, answer), protocol=5))
        except OSError:
            self._part(guest)

    def _part(self, guest: _Guest) -> None:
        if guest.channel.closed:
            return
        self._ready.unregister(guest.channel)
        guest.channel.close()
        if guest.outline is not None:
            guest.outline.drop_slot(guest.slot)


def _launches(asked: Sequence[_Asked]) -> Iterator[Sequence[_Asked]]:
    """What is scored together: the questions about one mesh, as many as have room."""
    for outline in dict.fromkeys(one.outline for one in asked):
        together: list[_Asked] = []
        size = 0
        for one in asked:
            if one.outline is not outline:
                continue
            if together and size + one.transforms.nbytes > MOST_BYTES:
                yield together
                together, size = [], 0
            together.append(one)
            size += one.transforms.nbytes
        yield together


def shared_device(any_kind: bool) -> DeviceReport:
    """The device to share: a GPU, or with ``any_kind`` the best there is. Raises ``DeviceError``."""
    usable = [report for report in find_devices() if report.rejected is None]
    usable = [report for report in usable if any_kind or report.kind == "gpu"]
    if not usable:
        raise DeviceError("no device worth sharing")
    return usable[0]
