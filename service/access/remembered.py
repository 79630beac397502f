"""Credentials found good, for a few seconds: a signature or a database row is not asked for with every frame."""

from __future__ import annotations

import hashlib
import time
from collections import OrderedDict

from service.access.principal import Principal

MOST = 10_000


class Remembered:
    """Credential -> principal, by the credential's hash; bounded, the oldest forgotten first."""

    def __init__(self, lifetime_s: float) -> None:
        self._lifetime_s = lifetime_s
        self._found: OrderedDict[bytes, tuple[float, Principal]] = OrderedDict()

    def get(self, credential: str) -> Principal | None:
        """The principal of a credential that was found good lately."""
        until, principal = self._found.get(_digest(credential), (0.0, None))
        return principal if time.monotonic() < until else None

    def put(self, credential: str, principal: Principal) -> None:
        """Remember a credential that was found good."""
        digest = _digest(credential)
        self._found.pop(digest, None)
        self._found[digest] = (time.monotonic() + self._lifetime_s, principal)
        if len(self._found) > MOST:
            self._found.popitem(last=False)

    def forget(self, key_id: str | None) -> None:
        """Forget every credential of a key, or of all (None)."""
        if key_id is None:
            self._found.clear()
        for digest in [digest for digest, (_, principal) in self._found.items() if principal.key_id == key_id]:
            del self._found[digest]


def _digest(credential: str) -> bytes:
    return hashlib.sha256(credential.encode()).digest()
