"""A worker's end of a device that several workers share: a scorer that asks the device's owner.

Messages are pickles over a Unix socket in a folder of our own: both ends are ours.
"""

from __future__ import annotations

import pickle
import socket
import struct
from collections.abc import Callable
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from gpu.auto import AutoScorer
from gpu.errors import DeviceError, DeviceLostError, ImageSizeError, ScorerError
from gpu.looping import Floats, LoopingScorer, Map, Transforms
from gpu.mesh import Mesh
from gpu.outline import LARGEST_SIDE
from gpu.prefix import fixed_point_prefix
from gpu.scorer import Scorer, open_scorer

PATIENCE_S = 60  # the owner may be starting, or preparing a mesh
MOST_PARTICLES = 5_000  # of a session; more fill the device alone
SHARED = ("auto", "outline")  # backends

Opener = Callable[[str, str, Mesh], Scorer]
"""Key of a model, backend, mesh -> its scorer."""


def open_alone(model: str, backend: str, mesh: Mesh) -> Scorer:
    """A scorer on a device of the worker's own choice."""
    return open_scorer(mesh, backend=backend)


def open_shared(address: str) -> Opener:
    """Scorers that ask the owner at ``address`` where they can."""

    def open_one(model: str, backend: str, mesh: Mesh) -> Scorer:
        if backend not in SHARED:
            return open_scorer(mesh, backend=backend)
        try:
            scorer = SharedScorer(address, model, mesh)
        except DeviceError:  # it has no device worth sharing, or is gone
            return open_scorer(mesh, backend=backend)
        if backend == "outline":
            return scorer
        return AutoScorer([lambda: scorer, partial(_alone, mesh)])

    return open_one


def _alone(mesh: Mesh) -> AutoScorer:
    scorer = open_scorer(mesh)
    assert isinstance(scorer, AutoScorer), "the default backend"
    return scorer


class SharedScorer(LoopingScorer):
    """Implements ``gpu.scorer.Scorer``. Owned, used and closed by one thread."""

    def __init__(self, address: str, model: str, mesh: Mesh) -> None:
        """Raises ``DeviceError`` where nobody answers, or with no device."""
        self._parts = len(mesh.parts)
        self._sent: tuple[Map, Floats] | None = None  # the maps that the owner has, and their units
        try:
            with socket.socket(socket.AF_UNIX) as end:
                end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("ll", PATIENCE_S, 0))
                end.connect(address)
                self._channel = Connection(end.detach())
        except OSError as error:
            raise DeviceError(f"the device's owner cannot be reached: {error}") from error
        try:
            name = self._ask("open", model)
            self.name: str = name if name is not None else self._ask("mesh", mesh)
        except ScorerError:
            self._channel.close()
            raise

    def score(self, part_transforms: Transforms, log_ratio: Map) -> Floats:
        """See ``Scorer.score``."""
        return self.score_many(part_transforms, log_ratio[None])[:, 0]

    def score_many(self, part_transforms: Transforms, maps: Map) -> Floats:
        """See ``Scorer.score_many``."""
        transforms = np.ascontiguousarray(part_transforms, dtype=np.float32)
        if transforms.shape[1:] != (self._parts, 3, 4):
            raise ScorerError(f"transforms are {transforms.shape}, not (N, {self._parts}, 3, 4)")
        if max(maps.shape[-2:]) > LARGEST_SIDE:
            message = f"an image of {maps.shape[-1]} x {maps.shape[-2]} is larger than {LARGEST_SIDE} a side"
            raise ImageSizeError(message, LARGEST_SIDE)
        prefix = None
        if self._sent is None or self._sent[0] is not maps or maps.flags.writeable:
            prefix, units = fixed_point_prefix(maps)
            self._sent = maps, units
        if len(transforms) == 0:
            self._sent = None
            return np.zeros((0, len(maps)))
        return np.asarray(self._ask("score", prefix, transforms) * self._sent[1], dtype=np.float64)

    def close(self) -> None:
        """Leave."""
        self._channel.close()

    def _ask(self, *message: object) -> Any:
        try:
            self._channel.send_bytes(pickle.dumps(message, protocol=5))
            error, answer = pickle.loads(self._channel.recv_bytes())
        except BlockingIOError as failure:
            raise DeviceLostError(f"the device's owner gives no answer in {PATIENCE_S} s") from failure
        except (EOFError, OSError) as failure:
            raise DeviceLostError("the device's owner is gone") from failure
        if error is not None:
            raise error
        return answer
