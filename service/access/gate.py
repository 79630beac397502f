"""Who is let in: the one place that turns what a call shows into a principal, or refuses it."""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import ipaddress
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from service.access.keys import PREFIX, Keys
from service.access.principal import LOCAL, OIDC_PREFIX, Principal, Role
from service.access.tickets import Tickets
from service.errors import ConfigError, ForeignOriginError, UnauthorizedError
from service.settings import Settings
from service.store.scope import DEFAULT_TENANT

if TYPE_CHECKING:
    from service.access.oidc import Oidc

BOOTSTRAP = Principal(DEFAULT_TENANT, "bootstrap", Role.ADMIN)
MIN_BOOTSTRAP_CHARACTERS = 32
_LEAST_CHECK_S = 1.0
_PORT = re.compile(r":\d+$")


@dataclass(frozen=True)
class Shown:
    """What a call shows of itself."""

    authorization: str | None
    ticket: str | None
    host: str
    origin: str | None


class Gate:
    """Lets callers in."""

    def __init__(self, settings: Settings, keys: Keys, oidc: Oidc | None, tickets: Tickets) -> None:
        self._settings = settings
        self._keys = keys
        self._oidc = oidc
        self._tickets = tickets
        self._bootstrap = _bootstrap_hash(settings.bootstrap_key_file)
        self._origins = frozenset(settings.allowed_origins.split())
        self._hosts = frozenset(settings.allowed_hosts.lower().split())
        self._needs_credential = settings.needs_credential

    @property
    def needs_stored_key(self) -> bool:
        """Whether nobody gets in without a key of the store."""
        return self._needs_credential and self._bootstrap is None and self._oidc is None

    async def admit(self, shown: Shown) -> Principal:
        """Who calls. Raises ``UnauthorizedError``, ``ForbiddenError``, or ``IdentityProviderError``."""
        if shown.origin is not None and not self._is_own(shown.origin, shown.host):
            raise ForeignOriginError(
                f"calls from {shown.origin} are not taken", field="header:Origin", setting="SKYPOSE_ALLOWED_ORIGINS"
            )
        if shown.ticket is not None:
            return await self._tickets.redeem(shown.ticket)
        if shown.authorization is not None and self._settings.auth != "off":  # else it is for whoever stands before us
            return await self._verify(shown.authorization)
        if self._needs_credential:
            raise UnauthorizedError("a key is needed: Authorization: Bearer skypose_...", field="header:Authorization")
        if not self._is_local_name(shown.host):  # it could be a site's own name for this address
            raise ForeignOriginError(
                f"without a key, calls to {shown.host!r} are not taken",
                field="header:Host",
                setting="SKYPOSE_ALLOWED_HOSTS",
            )
        return LOCAL

    async def require_credentials(self) -> None:
        """Raises ``ConfigError`` where credentials are needed and there are none that could be shown."""
        if self.needs_stored_key:
            require_keys(self._settings, await self._keys.count_active())

    async def until_ended(self, principal: Principal) -> None:
        """Return when the credential of a long call is no longer good; never for one that cannot end."""
        if principal.key_id in (LOCAL.key_id, BOOTSTRAP.key_id):
            await asyncio.Event().wait()
        check_s = max(self._settings.credential_cache_s, _LEAST_CHECK_S)
        while principal.expires is None or principal.expires > datetime.now(UTC):
            await asyncio.sleep(check_s)
            if not principal.key_id.startswith(OIDC_PREFIX) and not await self._keys.is_active(principal.key_id):
                return

    async def _verify(self, authorization: str) -> Principal:
        scheme, _, token = authorization.partition(" ")
        token = token.strip()
        if scheme.lower() != "bearer" or not token:
            raise UnauthorizedError("the form is: Authorization: Bearer ...", field="header:Authorization")
        if token.startswith(PREFIX):
            return await self._keys.verify(token)
        if self._bootstrap is not None and hmac.compare_digest(_sha256(token), self._bootstrap):
            return BOOTSTRAP
        if self._oidc is None:
            raise UnauthorizedError("the key is not known, or no longer good", field="header:Authorization")
        return await self._oidc.verify(token)

    def _is_own(self, origin: str, host: str) -> bool:
        scheme, separator, netloc = origin.partition("://")
        own = separator and scheme in ("http", "https") and host and _place(netloc, scheme) == _place(host, scheme)
        return bool(own) or origin in self._origins

    def _is_local_name(self, host: str) -> bool:
        name = _PORT.sub("", host.lower()).strip("[]")
        return name == "localhost" or _address(name) is not None or not self._hosts.isdisjoint((name, "*"))


def require_keys(settings: Settings, active: int) -> None:
    """Raises ``ConfigError`` where nobody could get in, with what to do about it."""
    if active == 0:
        raise ConfigError(
            f"refusing to listen on {settings.host} without any key: make one first\n"
            f"    skypose keys create --role admin --name me --data {settings.data_dir}\n"
            "or set SKYPOSE_BOOTSTRAP_KEY_FILE, or SKYPOSE_OIDC_ISSUER and its companions (docs/security.md).\n"
            "SKYPOSE_AUTH=off takes every call from everybody: only behind a proxy or a port that guards it.",
            field="SKYPOSE_AUTH",
        )


def _address(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(name)
    except ValueError:
        return None  # a name


def _place(netloc: str, scheme: str) -> str:
    return netloc.lower().removesuffix(":443" if scheme == "https" else ":80")


def _bootstrap_hash(file: Path | None) -> str | None:
    if file is None:
        return None
    try:
        text = file.read_text().strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{file} cannot be read: {error}", field="SKYPOSE_BOOTSTRAP_KEY_FILE") from error
    if len(text) < MIN_BOOTSTRAP_CHARACTERS or not text.isascii() or not text.isprintable() or text.startswith(PREFIX):
        raise ConfigError(
            f"{file} must hold at least {MIN_BOOTSTRAP_CHARACTERS} printable ASCII characters, not {PREFIX}...",
            field="SKYPOSE_BOOTSTRAP_KEY_FILE",
        )
    return _sha256(text)


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
