"""How processes on one database know each other: calls that one hands on to another are signed.

The secret lies in the database they share, made by the first of them. Who calls was decided where the call came in; the
signature carries that to the owner of the session, for this one call with this body, once, within a minute of the
database's clock: what the machines' own clocks say does not matter, nor when they step.
"""

from __future__ import annotations

import secrets
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import asdict
from datetime import datetime

import structlog

from service.access.principal import KeyRates, Principal, Role
from service.errors import StaleOwnerError, UnauthorizedError
from service.store import instances
from service.store.database import Database

log = structlog.get_logger(__name__)
HEADER = "x-skypose-peer"
PEER_FIELD = f"header:{HEADER}"  # which part of a call is refused: none that a client sent
FORWARDED = "forwarded"  # in a call's state: a peer handed it on
BODY_SHA256 = "body_sha256"  # there too: what that peer signed
_ALGORITHM = "HS256"
_GOOD_FOR_S = 60.0
_SKEW_S = 30.0  # between what two processes take for the database's time


class Peers:
    """Signs and checks calls between processes. ``me`` is this one's name, ``clock`` the time they have in common."""

    def __init__(self, database: Database, me: str, clock: Callable[[], float]) -> None:
        self._database = database
        self._me = me
        self._clock = clock
        self._secret = ""
        self._used: OrderedDict[str, float] = OrderedDict()  # nonce -> until when it is remembered, in this order

    async def open(self) -> None:
        """Learn the secret. Before that, nobody is believed."""
        self._secret = await self._database.write(instances.secret)

    def sign(self, caller: Principal, to: str, method: str, target: str, body_sha256: str) -> str:
        """What the process ``to`` takes as: this call (``target`` is path and query) is ``caller``'s. Good once."""
        import jwt  # a tenth of a second of every start, needed only in a cluster

        claims = {
            "aud": to,
            "exp": self._clock() + _GOOD_FOR_S,
            "jti": secrets.token_urlsafe(16),
            "call": [method, target, body_sha256],
            "caller": [caller.tenant, caller.key_id, caller.role.value],
            "rates": asdict(caller.rates),
            "until": "" if caller.expires is None else caller.expires.isoformat(),
        }
        return jwt.encode(claims, self._secret, _ALGORITHM)

    def verify(self, token: str, method: str, target: str) -> tuple[Principal, str]:
        """Who calls, and the SHA-256 that the body must have.

        Raises ``UnauthorizedError`` for what no peer signed, for another call, and for what was shown before.

        ``StaleOwnerError`` for what was meant for another process: one that had this address before.
        """
        import jwt

        try:
            if not self._secret:
                raise jwt.InvalidTokenError
            claims = jwt.decode(
                token,
                self._secret,
                [_ALGORITHM],
                audience=self._me,
                options={
                    "require": ["aud", "exp", "jti", "call", "caller", "rates", "until"],
                    "verify_exp": False,  # it would look at this machine's clock
                },
            )
            if claims["exp"] + _SKEW_S < self._clock():
                raise jwt.ExpiredSignatureError
            *signed, body_sha256 = claims["call"]
            if signed != [method, target] or not self._is_first(claims["jti"]):
                raise jwt.InvalidTokenError
        except jwt.InvalidAudienceError as error:
            raise StaleOwnerError("the process that this call was meant for has gone") from error
        except jwt.InvalidTokenError as error:
            log.warning("a call that says it comes from a peer is refused", reason=repr(error), call=target)
            raise UnauthorizedError("no process of this cluster signed this call", field=PEER_FIELD) from error
        tenant, key_id, role = claims["caller"]
        until = datetime.fromisoformat(claims["until"]) if claims["until"] else None
        return Principal(tenant, key_id, Role(role), until, KeyRates(**claims["rates"])), body_sha256

    def _is_first(self, nonce: str) -> bool:
        """Whether a nonce was not shown before; remembered for as long as its signature could be good."""
        now = time.monotonic()
        while self._used and next(iter(self._used.values())) < now:
            self._used.popitem(last=False)
        if nonce in self._used:
            return False
        self._used[nonce] = now + _GOOD_FOR_S + 2 * _SKEW_S
        return True
