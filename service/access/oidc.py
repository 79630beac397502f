"""Tokens of an identity provider (OpenID Connect): JSON web tokens, held against its published keys."""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import Awaitable, Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx
import jwt
import orjson
import structlog

from service.access.principal import OIDC_PREFIX, TENANT_PATTERN, Principal, Role
from service.access.provider import Provider
from service.access.remembered import Remembered
from service.errors import ConfigError, ForbiddenError, IdentityProviderError, UnauthorizedError
from service.settings import Settings

log = structlog.get_logger(__name__)
# Asymmetric ones only: with a shared secret, whoever can check a token could write one.
ALGORITHMS = ["RS256", "RS384", "RS512", "PS256", "PS384", "PS512", "ES256", "ES384", "ES512", "EdDSA"]
LEEWAY_S = 30
_RETRY_S = 30.0
_FETCH_TIMEOUT_S = 5.0
_MOST_BYTES = 1 << 20
_MOST_SUBJECT = 200
Source = Callable[[], Awaitable[bytes]]


class KeySet:
    """The provider's keys, fetched when first needed and again when old or when a key is not among them."""

    def __init__(self, source: Source, cache_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._source = source
        self._cache_s = cache_s
        self._clock = clock
        self._keys: dict[str | None, jwt.PyJWK] = {}
        self._fetched = self._tried = float("-inf")
        self._fetching = asyncio.Lock()

    async def get(self, key_id: str | None) -> jwt.PyJWK:
        """The key of this id; of a set of one, that one without an id.

        Raises ``UnauthorizedError`` for an unknown id, ``IdentityProviderError`` where no keys can be had.
        """
        if not self._has(key_id) or self._clock() - self._fetched > self._cache_s:
            async with self._fetching:
                if self._clock() - self._tried > _RETRY_S:  # whoever waited here finds what the first one fetched
                    await self._fetch()
        if not self._keys:
            raise IdentityProviderError("the identity provider's keys cannot be had")
        if not self._has(key_id):
            raise UnauthorizedError("the token is signed with a key that is not known", field="header:Authorization")
        return self._keys[key_id] if key_id is not None else next(iter(self._keys.values()))

    def _has(self, key_id: str | None) -> bool:
        return len(self._keys) == 1 if key_id is None else key_id in self._keys

    async def _fetch(self) -> None:
        self._tried = self._clock()
        try:
            found = jwt.PyJWKSet.from_dict(orjson.loads(await self._source()))
        except (OSError, httpx.HTTPError, ValueError, AttributeError, jwt.PyJWTError) as error:
            log.warning("identity provider's keys not fetched", error=f"{type(error).__name__}: {error}")
            return  # the keys there are stay good: the next token after a while tries again
        self._keys = {key.key_id: key for key in found.keys if key.key_type != "oct"}
        self._fetched = self._tried


class Oidc:
    """Checks tokens."""

    def __init__(self, provider: Provider, keys: KeySet, cache_s: float) -> None:
        self._provider = provider
        self._keys = keys
        self._remembered = Remembered(cache_s)

    async def verify(self, token: str) -> Principal:
        """Whose token it is. Raises ``UnauthorizedError``, ``ForbiddenError`` for claims that give nothing here."""
        known = self._remembered.get(token)
        if known is None or known.expires is None or known.expires < datetime.now(UTC):
            known = self._principal(await self._claims(token))
            self._remembered.put(token, known)
        return known

    async def _claims(self, token: str) -> Mapping[str, Any]:
        try:
            key_id = jwt.get_unverified_header(token).get("kid")
            key = await self._keys.get(key_id if isinstance(key_id, str) else None)
            claims: dict[str, Any] = jwt.decode(
                token,
                key=key,
                algorithms=ALGORITHMS,
                audience=self._provider.audience,
                issuer=self._provider.issuer,
                leeway=LEEWAY_S,
                options={"require": ["exp", "iss", "aud", "sub"]},
            )
        except (jwt.PyJWTError, TypeError) as error:  # TypeError: of an issuer that is no text
            raise UnauthorizedError(f"the token is not good: {error}", field="header:Authorization") from error
        return claims

    def _principal(self, claims: Mapping[str, Any]) -> Principal:
        tenant = claim(claims, self._provider.tenant_claim)
        if not isinstance(tenant, str) or not re.fullmatch(TENANT_PATTERN, tenant):
            raise ForbiddenError("the token names no tenant", claim=self._provider.tenant_claim)
        given = claim(claims, self._provider.role_claim)
        names = [given] if isinstance(given, str) else given if isinstance(given, list) else []
        roles = [role for role in Role if role.value in names]
        if not roles:
            known = [role.value for role in Role]
            raise ForbiddenError("the token names no role", claim=self._provider.role_claim, known=known)
        try:
            expires = datetime.fromtimestamp(float(claims["exp"]) + LEEWAY_S, UTC)
        except (OverflowError, ValueError, OSError) as error:  # past all years, or no number
            raise UnauthorizedError("the token's exp is no time", field="header:Authorization") from error
        return Principal(tenant, OIDC_PREFIX + str(claims["sub"])[:_MOST_SUBJECT], roles[-1], expires)


def claim(claims: Mapping[str, Any], name: str) -> Any:
    """A claim by its name, or by its path (``realm_access.roles``); None where there is none."""
    if name in claims:
        return claims[name]
    found: Any = claims
    for part in name.split("."):
        found = found.get(part) if isinstance(found, Mapping) else None
    return found


def open_provider(provider: Provider, jwks: str, settings: Settings) -> Oidc:
    """Raises ``ConfigError`` for an address that keys cannot be had from."""
    return Oidc(provider, KeySet(_source(jwks), settings.oidc_jwks_cache_s), settings.credential_cache_s)


def _source(jwks: str) -> Source:
    if jwks.startswith("https://"):
        return lambda: _download(jwks)
    if "://" in jwks:
        raise ConfigError("SKYPOSE_OIDC_JWKS is a file or an https:// address", field="SKYPOSE_OIDC_JWKS")
    return lambda: asyncio.to_thread(Path(jwks).read_bytes)


async def _download(address: str) -> bytes:
    async with httpx.AsyncClient(timeout=_FETCH_TIMEOUT_S) as client, client.stream("GET", address) as answer:
        answer.raise_for_status()
        body = b""
        async for part in answer.aiter_bytes():
            body += part
            if len(body) > _MOST_BYTES:
                raise ValueError(f"more than {_MOST_BYTES} bytes")
        return body
