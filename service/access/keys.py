"""API keys: ``skypose_<id>_<secret>``, 256 random bits, known to the store by their SHA-256 only.

A fast hash is right here: nobody guesses 256 random bits, so there is nothing that a slow one would slow down.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime, timedelta

import structlog

from service.access.principal import TENANT_PATTERN, KeyRates, Principal, Role
from service.access.remembered import Remembered
from service.access.together import Together
from service.errors import ConfigError, DamagedError, UnauthorizedError
from service.store import api_keys
from service.store.base import KeyRecord, Page
from service.store.database import Database

log = structlog.get_logger(__name__)
PREFIX = "skypose_"
_KEY = re.compile(r"skypose_([0-9a-f]{8})_([A-Za-z0-9_-]{43})")
_TOUCH_S = 300.0
LOOK_UPS_APART_S = 0.05
"""Between two look-ups of keys: a flood of false ones costs twenty of them a second."""
MAX_NAME = 100
NO_RATES = KeyRates()


def utc_text(moment: datetime) -> str:
    """A moment as stored: ISO 8601 in UTC to the second, which sorts as text."""
    return moment.astimezone(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")


def new_key(
    tenant: str, role: Role, name: str, days: float | None = None, rates: KeyRates = NO_RATES
) -> tuple[KeyRecord, str]:
    """A key to store, and its text, which is nowhere else. Raises ``ConfigError`` for a bad tenant or name."""
    if not re.fullmatch(TENANT_PATTERN, tenant):
        raise ConfigError("a tenant has 1 to 32 of a-z 0-9 _ -, and begins with a letter or digit", field="tenant")
    if not 1 <= len(name) <= MAX_NAME or not name.isprintable():
        raise ConfigError(f"a name has 1 to {MAX_NAME} printable characters", field="name", limit=MAX_NAME)
    now = datetime.now(UTC)
    key_id = secrets.token_hex(4)
    text = f"{PREFIX}{key_id}_{secrets.token_urlsafe(32)}"
    record = KeyRecord(
        id=key_id,
        sha256=_sha256(text),
        tenant=tenant,
        role=role.value,
        name=name,
        created_at=utc_text(now),
        expires_at=None if days is None else utc_text(now + timedelta(days=days)),
        rates={name: rate for name, rate in asdict(rates).items() if rate is not None} or None,
    )
    return record, text


def is_active(record: KeyRecord, now: datetime) -> bool:
    """Whether a key is neither revoked nor past its end."""
    return record.revoked_at is None and (record.expires_at is None or record.expires_at > utc_text(now))


class Keys:
    """Makes, checks and ends keys."""

    def __init__(self, database: Database, cache_s: float, quota: int = 0) -> None:
        self._database = database
        self._quota = quota
        self._remembered = Remembered(cache_s)
        self._records = Together(self._read, LOOK_UPS_APART_S)
        self._used: dict[str, datetime] = {}  # noted in the store, once in a while
        self._noted: dict[str, datetime] = {}

    async def verify(self, text: str) -> Principal:
        """Whose key it is. Raises ``UnauthorizedError`` for any that is not good."""
        known = self._remembered.get(text)
        if known is None:
            known = await self._look_up(text)
            self._remembered.put(text, known)
        self._used[known.key_id] = datetime.now(UTC)
        return known

    async def create(
        self, tenant: str, role: Role, name: str, days: float | None, rates: KeyRates = NO_RATES
    ) -> tuple[KeyRecord, str]:
        """A new key of a tenant, stored, and its text. Raises ``QuotaExceededError``."""
        record, text = new_key(tenant, role, name, days, rates)
        await self._database.write(api_keys.add, record, self._quota)
        return record, text

    async def page(self, tenant: str, after: int, limit: int) -> Page[KeyRecord]:
        """A tenant's keys after a cursor."""
        return await self._database.read(api_keys.page, tenant, after, limit)

    async def revoke(self, tenant: str, key_id: str) -> None:
        """End a tenant's key, at once. Raises ``NotFoundError``."""
        await self._database.write(api_keys.revoke, tenant, key_id, utc_text(datetime.now(UTC)))
        self.forget(key_id)

    def forget(self, key_id: str | None = None) -> None:
        """Look a key up again with its next call; without one, every key."""
        self._remembered.forget(key_id)

    async def is_active(self, key_id: str) -> bool:
        """Whether a key is still good."""
        record = await self._find(key_id)
        return record is not None and is_active(record, datetime.now(UTC))

    async def count_active(self) -> int:
        """How many good keys there are."""
        return await self._database.read(api_keys.count_active, utc_text(datetime.now(UTC)))

    async def note_use(self) -> None:
        """Store when keys were used, of each at most once in five minutes."""
        due = {key_id: at for key_id, at in self._used.items() if self._due(key_id, at)}
        if due:
            await self._database.write(api_keys.touch, {key_id: utc_text(at) for key_id, at in due.items()})
            self._noted.update(due)
        self._used.clear()

    def _due(self, key_id: str, at: datetime) -> bool:
        noted = self._noted.get(key_id)
        return noted is None or (at - noted).total_seconds() >= _TOUCH_S

    async def _read(self, key_ids: Sequence[str]) -> Mapping[str, KeyRecord | DamagedError]:
        return await self._database.read(api_keys.find_all, key_ids)

    async def _find(self, key_id: str) -> KeyRecord | None:
        """One that is not as it was stored is none: whose it is, and what it may, is not known."""
        found = await self._records.get(key_id)
        if isinstance(found, DamagedError):
            log.error("a damaged key was shown and not taken", key=key_id, reason=found.detail)
            return None
        return found

    async def _look_up(self, text: str) -> Principal:
        shape = _KEY.fullmatch(text)
        record = None if shape is None else await self._find(shape[1])
        # One answer for every reason: nobody learns which ids exist.
        same = record is not None and hmac.compare_digest(record.sha256, _sha256(text))
        if record is None or not same or not is_active(record, datetime.now(UTC)):
            raise UnauthorizedError("the key is not known, or no longer good", field="header:Authorization")
        expires = None if record.expires_at is None else datetime.fromisoformat(record.expires_at)
        return Principal(record.tenant, record.id, Role(record.role), expires, KeyRates(**(record.rates or {})))


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
