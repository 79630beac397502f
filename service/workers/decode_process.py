"""Decoding in a process that may die of it: limited in memory and time, replaced after every loss.

The process is started ahead, stays for all jobs of its owner, and takes one at a time.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

from gpu.raw_part import RawPart
from service.errors import ImageError, InputError, MeshFileError, TooLargeError, WorkerFailedError, every_error
from service.imaging.decode import ByteOrder, Frame
from service.imaging.facts import FrameFacts
from service.imaging.split import SplitFrame
from service.workers.decode_wire import (
    OUT_OF_MEMORY,
    Reply,
    receive_reply,
    send,
    unpack_facts,
    unpack_frames,
    unpack_parts,
    unpack_split,
)
from service.workers.limits import DecodeLimits
from service.workers.sandbox import Sandbox

_START = (
    "import sys; from service.workers.kernel import die_with; die_with(int(sys.argv[2])); "
    "from service.workers.decode_child import main; main(int(sys.argv[1]))"
)
# A process dies with the thread that started it: this one lives as long as its parent does.
_STARTER = ThreadPoolExecutor(1, thread_name_prefix="decoder-starter")
_START_TIMEOUT_S = 60.0
_SOCKET_BYTES = 1 << 20
_MOST_ATTEMPTS = 6
_NOT_THE_FILE = (None, -signal.SIGKILL)
_FIELDS = ("body", "file", "header:Content-Type")
_FACTS = ("limit", "found", "setting", "supported")
_REFUSALS = {kind.slug: kind for kind in every_error() if issubclass(kind, InputError)}


class _LostError(Exception):
    """The process ended, or had to be ended, in the middle of a job."""

    def __init__(self, reason: str, status: int | None) -> None:  # exit status; None: it never was ready
        super().__init__(reason)
        self.status = status


@dataclass
class _Child:
    process: subprocess.Popen[bytes]
    channel: socket.socket
    ready: bool = False
    sandbox: Sandbox = field(default_factory=Sandbox)  # as it says when it is ready


class DecodeProcess:
    """Implements ``service.workers.decoding.Decoder``. Threads may share it: they take turns."""

    def __init__(self, limits: DecodeLimits | None = None) -> None:
        self.limits = limits or DecodeLimits()
        self.losses = 0
        self._child: _Child | None = None
        self._turn = threading.Lock()

    @property
    def pid(self) -> int | None:
        """Process id, or None while there is none."""
        child = self._child
        return None if child is None else child.process.pid

    @property
    def sandbox(self) -> Sandbox:
        """What holds the process, which is brought up for it. Raises ``WorkerFailedError``."""
        with self._turn:
            try:
                return self._ready().sandbox
            except _LostError as loss:
                raise WorkerFailedError(f"the decoder {loss}") from loss

    def prestart(self) -> None:
        """Begin to bring the process up, without waiting."""
        with self._turn:
            self._begin()

    def frame(self, body: bytes, media_type: str, ser_byte_order: ByteOrder = "auto") -> Frame:
        """See ``Decoder``."""
        return unpack_frames(self._call("frame", body, media_type, ser_byte_order))[0]

    def frames(self, body: bytes, media_type: str, ser_byte_order: ByteOrder = "auto") -> tuple[Frame, ...]:
        """See ``Decoder``."""
        return unpack_frames(self._call("frames", body, media_type, ser_byte_order))

    def split(self, body: bytes, media_type: str, ser_byte_order: ByteOrder = "auto") -> tuple[SplitFrame, ...]:
        """See ``Decoder``."""
        return unpack_split(self._call("split", body, media_type, ser_byte_order))

    def facts(self, body: bytes, media_type: str) -> FrameFacts:
        """See ``Decoder``."""
        return unpack_facts(self._call("facts", body, media_type).value)

    def count(self, body: bytes, media_type: str) -> int | None:
        """See ``Decoder``."""
        count: int | None = self._call("count", body, media_type).value
        return count

    def parts(self, data: bytes, file_type: str) -> list[RawPart]:
        """See ``Decoder``."""
        return unpack_parts(self._call("parts", data, file_type))

    def close(self) -> None:
        """End the process. Another call would start it again."""
        with self._turn:
            self._end()

    def _call(self, method: str, body: bytes, *arguments: object) -> Reply:
        """Run a job. A file that ends two processes is refused; that somebody kills them is not the file's fault."""
        message = pickle.dumps((method, arguments), protocol=5)
        with self._turn:
            deaths = 0  # that may be the file's doing
            for _ in range(_MOST_ATTEMPTS):
                try:
                    return self._attempt(method, message, body)
                except _LostError as loss:
                    deaths += loss.status not in _NOT_THE_FILE
                    if deaths == 2:
                        raise self._ended(method, loss) from loss
                    last = loss
        raise WorkerFailedError(f"the decoder was lost {_MOST_ATTEMPTS} times: {last}")

    def _ended(self, method: str, loss: _LostError) -> InputError:
        if loss.status == OUT_OF_MEMORY:
            most = self.limits.memory_bytes >> 20
            detail = f"decoding takes more than {most} MiB of memory"
            return TooLargeError(detail, field=_field(method), limit=most, setting="SKYPOSE_DECODE_MEMORY_MB")
        kind = MeshFileError if method == "parts" else ImageError
        return kind(f"cannot be decoded: the decoder ended on it ({loss})", field=_field(method))

    def _attempt(self, method: str, message: bytes, body: bytes) -> Reply:
        child = self._ready()
        until = time.monotonic() + self.limits.timeout_s
        try:
            child.channel.settimeout(self.limits.timeout_s)
            send(child.channel, message)
            send(child.channel, body)
            reply = receive_reply(child.channel, self.limits.memory_bytes, until)
        except TimeoutError as error:
            self._lose("too slow")
            raise _too_slow(method, "SKYPOSE_DECODE_TIMEOUT_S", self.limits.timeout_s) from error
        except (EOFError, OSError, ValueError) as error:
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.process.wait(1.0)  # it closed its end first
            status = child.process.poll()
            reason = f"{type(error).__name__}, status {status}"
            self._lose(reason)
            if status == -signal.SIGXCPU:
                raise _too_slow(method, "SKYPOSE_DECODE_CPU_S", self.limits.cpu_s) from error
            raise _LostError(reason, status) from error
        if isinstance(reply.value, dict) and "error" in reply.value:
            raise _refusal(method, reply.value)
        return reply

    def _lose(self, reason: str) -> None:
        self.losses += 1
        _warn("decoder lost", reason=reason, pid=self.pid)
        self._end()
        self._begin()  # the next job finds it ready, or nearly

    def _begin(self) -> _Child:
        """The process, just started if there was none."""
        if self._child is None:
            here, there = socket.socketpair()
            for end in (here, there):
                end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SOCKET_BYTES)
            process = _STARTER.submit(_started, there.fileno()).result()
            there.close()  # so that the end of the process is the end of the stream
            self._child = _Child(process, here)
            with contextlib.suppress(OSError):  # it is gone already: the first job will say so
                send(here, pickle.dumps(self.limits))
        return self._child

    def _ready(self) -> _Child:
        child = self._begin()
        if not child.ready:
            try:
                reply = receive_reply(child.channel, 0, time.monotonic() + _START_TIMEOUT_S)
            except (EOFError, OSError, ValueError) as error:
                self._end()
                raise _LostError(f"does not start: {type(error).__name__}", None) from error
            child.ready, child.sandbox = (
                True,
                self._accepted(Sandbox(tuple(reply.value["in_force"]), reply.value["missing"])),
            )
        return child

    def _accepted(self, sandbox: Sandbox) -> Sandbox:
        if sandbox.missing and self.limits.sandbox == "required":
            self._end()
            raise WorkerFailedError(f"SKYPOSE_DECODE_SANDBOX is required, but of it holds: {sandbox}")
        if sandbox.missing:
            _warn("decode sandbox not complete", missing=sandbox.missing)
        return sandbox

    def _end(self) -> None:
        child, self._child = self._child, None
        if child is not None:
            child.channel.close()
            child.process.kill()
            child.process.wait()


def _started(descriptor: int) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-c", _START, str(descriptor), str(os.getpid())],
        env=_environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        pass_fds=(descriptor,),
    )


def _warn(event: str, **facts: object) -> None:
    import structlog  # a tenth of a second and ten megabytes of every worker, which seldom has anything to say

    structlog.get_logger(__name__).warning(event, **facts)


def _refusal(method: str, value: dict[str, Any]) -> InputError:
    if "traceback" in value:
        _warn("decoder tripped", traceback=value["traceback"])
    kind = _REFUSALS.get(str(value["error"]), InputError)
    facts = {name: fact for name, fact in value.get("facts", {}).items() if name in _FACTS}
    field = value.get("field")
    return kind(str(value["detail"]), field=field if field in _FIELDS else _field(method), **facts)


def _too_slow(method: str, setting: str, limit: float) -> TooLargeError:
    detail = f"decoding takes longer than {limit:g} s"
    return TooLargeError(detail, field=_field(method), limit=limit, setting=setting)


def _field(method: str) -> str:
    return "file" if method == "parts" else "body"


def _environment() -> dict[str, str]:
    """Nothing of ours but where the code is: what a decoder does not know it cannot give away."""
    kept = {name: os.environ[name] for name in ("PATH", "LANG", "LC_ALL") if name in os.environ}
    return {
        **kept,
        "PYTHONPATH": os.pathsep.join(sys.path),
        "HOME": "/nonexistent",  # astropy asks for one, and would ask the user database
        "PYTHONDONTWRITEBYTECODE": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "MALLOC_ARENA_MAX": "2",
        "OPENCV_LOG_LEVEL": "SILENT",
        "OPENCV_FFMPEG_LOGLEVEL": "-8",
    }
