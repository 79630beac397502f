"""Files, TCP and signals kept from a process by Landlock (Linux 5.13 or newer), beneath what its user may do."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterable
from pathlib import Path

from service.workers import kernel

_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446  # the same on every machine
_ASK_VERSION, _PATH_BENEATH = 1, 1
_READ_FILE, _READ_DIRECTORY = 1 << 2, 1 << 3
_RIGHTS = {1: 13, 2: 14, 3: 15, 5: 16}  # version -> how many rights to files it knows
_TCP_SINCE, _TCP = 4, 3  # bind and connect
_SCOPES_SINCE, _SCOPES = 6, 3  # no abstract sockets of others, no signals to others


def restrict(readable: Iterable[Path]) -> None:
    """Hold this thread, and those that it starts, to reading beneath these paths, for good.

    Paths that are not there are left out. Raises ``OSError`` where the kernel has no Landlock.
    """
    version = kernel.call(_CREATE_RULESET, None, 0, _ASK_VERSION)
    rights = (1 << max(count for since, count in _RIGHTS.items() if since <= version)) - 1
    tcp, scopes = _TCP * (version >= _TCP_SINCE), _SCOPES * (version >= _SCOPES_SINCE)
    ruleset = kernel.call(_CREATE_RULESET, struct.pack("=QQQ", rights, tcp, scopes), 24, 0)
    try:
        for path in readable:
            if path.exists():
                _allow(ruleset, path)
        kernel.call(_RESTRICT_SELF, ruleset, 0)
    finally:
        os.close(ruleset)


def _allow(ruleset: int, path: Path) -> None:
    handle = os.open(path, os.O_PATH | os.O_CLOEXEC)
    try:
        allowed = _READ_FILE | _READ_DIRECTORY if path.is_dir() else _READ_FILE
        kernel.call(_ADD_RULE, ruleset, _PATH_BENEATH, struct.pack("=Qi", allowed, handle), 0)
    finally:
        os.close(handle)
