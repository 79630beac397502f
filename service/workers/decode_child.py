"""The decode process: limits on itself first, then one job after the other until its parent is gone.

It holds no device, no database and no secret, and its memory and time are limited by the kernel: a file that breaks
a decoder breaks this process and nothing else. A file that takes it over finds itself in ``service.workers.sandbox``.
"""

from __future__ import annotations

import importlib
import os
import pickle
import resource
import socket
import traceback
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2

import gpu.mesh_file  # noqa: F401 -- what it loads must not count as a job's memory
from service.errors import InputError, SkyposeError
from service.workers.decode_wire import (
    OUT_OF_MEMORY,
    Reply,
    pack_facts,
    pack_frames,
    pack_parts,
    pack_split,
    receive_bytes,
    send_reply,
)
from service.workers.decoding import InPlace
from service.workers.limits import DecodeLimits
from service.workers.sandbox import Sandbox, enter

_FILES = 64
_LATER = ("service.imaging.formats.fits", "astropy.io.fits.hdu.compressed", "astropy.wcs")  # imported when needed


def main(descriptor: int) -> None:
    """Serve the parent at the other end of a socket. The first message brings the limits."""
    channel = socket.socket(fileno=descriptor)
    try:
        limits: DecodeLimits = pickle.loads(receive_bytes(channel))
        cv2.setNumThreads(1)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # decoders write of every bad file; the parent has the answer
        confine(limits)
        sandbox = Sandbox() if limits.sandbox == "off" else enter(_load_all)
        jobs = _jobs(InPlace(limits))
        send_reply(channel, Reply(asdict(sandbox)))  # ready
        while True:
            method, arguments = pickle.loads(receive_bytes(channel))
            body = receive_bytes(channel)
            allow_cpu(limits.cpu_s)
            send_reply(channel, answer(jobs[method], (body, *arguments)))
    except (EOFError, ConnectionError):  # the parent is gone, maybe before it ever asked
        return
    except MemoryError:  # the file does not even fit, or its pixels do not fit twice
        os._exit(OUT_OF_MEMORY)


def confine(limits: DecodeLimits) -> None:
    """Limit this process's memory, files and core dumps, for good."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + limits.memory_bytes
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_FSIZE, (limits.memory_bytes, limits.memory_bytes))  # files in memory count too
    resource.setrlimit(resource.RLIMIT_NOFILE, (_FILES, _FILES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _load_all() -> None:
    for name in _LATER:
        importlib.import_module(name)


def allow_cpu(seconds: int) -> None:
    """Let the kernel end this process (SIGXCPU) after so much more computing."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    most = int(used.ru_utime + used.ru_stime) + 1 + seconds
    resource.setrlimit(resource.RLIMIT_CPU, (most, resource.getrlimit(resource.RLIMIT_CPU)[1]))


def answer(job: Callable[..., Reply], arguments: tuple[Any, ...]) -> Reply:
    """What a job gives, or the error that it raises, as a reply. Ends the process where memory does not suffice."""
    try:
        return job(*arguments)
    except SkyposeError as error:
        return Reply(_error(error))
    except MemoryError:
        os._exit(OUT_OF_MEMORY)  # the parent knows the limit; a new process has no remains of this job
    except Exception as error:  # noqa: BLE001 -- what a decoder trips over is the file's fault; the log has the trace
        refused = InputError(f"cannot be decoded: {type(error).__name__}: {error}")
        return Reply({**_error(refused), "traceback": traceback.format_exc()})


def _error(error: SkyposeError) -> dict[str, Any]:
    return {"error": type(error).slug, "detail": error.detail, "field": error.field, "facts": error.facts}


def _jobs(decoder: InPlace) -> Mapping[str, Callable[..., Reply]]:
    return {
        "frame": lambda *a: pack_frames([decoder.frame(*a)]),
        "frames": lambda *a: pack_frames(decoder.frames(*a)),
        "split": lambda *a: pack_split(decoder.split(*a)),
        "facts": lambda *a: pack_facts(decoder.facts(*a)),
        "count": lambda *a: Reply(decoder.count(*a)),
        "parts": lambda *a: pack_parts(decoder.parts(*a)),
    }
