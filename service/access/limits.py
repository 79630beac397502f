"""How much a key may do in a second: a bucket per key and kind, which fills at the rate and may fall into debt.

A call is refused while the bucket is empty, so one of any size passes when it is the first in a while, and the ones
after it wait until it is paid for.
"""

from __future__ import annotations

import math
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from service.access.principal import DEFAULT_TENANT, KeyRates, Principal
from service.errors import ConfigError, RateLimitedError
from service.settings import MEBIBYTE, Settings

Kind = Literal["calls", "bytes", "pixels"]
BURST_S = 2.0
MOST_KEYS = 10_000
MEGAPIXEL = 1_000_000
RATE_NAMES: dict[Kind, str] = {"calls": "calls_per_s", "bytes": "megabytes_per_s", "pixels": "megapixels_per_s"}
UNITS: dict[Kind, float] = {"calls": 1, "bytes": MEBIBYTE, "pixels": MEGAPIXEL}


@dataclass(frozen=True)
class Rate:
    """So much in a second; 0 is any."""

    per_s: float
    setting: str
    limit: float  # as the setting, or the key, says it


@dataclass
class _Bucket:
    level: float
    at: float


class Limits:
    """The buckets of all keys. A key's own rate stands for that of the settings."""

    def __init__(self, settings: Settings, clock: Callable[[], float] = time.monotonic) -> None:
        self._of_all = KeyRates(
            settings.rate_calls_per_s, settings.rate_megabytes_per_s, settings.rate_megapixels_per_s
        )
        self._clock = clock
        self._buckets: OrderedDict[tuple[str, str, Kind], _Bucket] = OrderedDict()

    def check(self, principal: Principal, kind: Kind) -> None:
        """Raises ``RateLimitedError`` while what was taken before is not paid for."""
        rate = self._rate(principal, kind)
        if rate.per_s:
            level = self._bucket(principal, kind, rate).level
            if level <= 0:
                wait = max(1, math.ceil(-level / rate.per_s))
                raise RateLimitedError(
                    f"this key has used up its {kind} for now",
                    limit=rate.limit,
                    setting=rate.setting,
                    retry_after_s=wait,
                )

    def take(self, principal: Principal, kind: Kind, amount: float) -> None:
        """Take so much, into debt if need be."""
        rate = self._rate(principal, kind)
        if rate.per_s:
            self._bucket(principal, kind, rate).level -= amount

    def require_grantable(self, principal: Principal, wanted: KeyRates) -> None:
        """Raises ``ConfigError`` where a tenant's own admin would give a key more than the operator gives it."""
        if principal.tenant == DEFAULT_TENANT:
            return
        for name in RATE_NAMES.values():
            most, rate = getattr(self._of_all, name), getattr(wanted, name)
            if rate is not None and most and not 0 < rate <= most:
                setting = f"SKYPOSE_RATE_{name.upper()}"
                message = f"a key of this tenant may have more than 0 and at most {most:g}"
                raise ConfigError(message, field=f"rates.{name}", limit=most, setting=setting)

    def _rate(self, principal: Principal, kind: Kind) -> Rate:
        name = RATE_NAMES[kind]
        own, of_all = getattr(principal.rates, name), getattr(self._of_all, name)
        if own is None:
            return Rate(of_all * UNITS[kind], f"SKYPOSE_RATE_{name.upper()}", of_all)
        return Rate(own * UNITS[kind], f"{name} of the key", own)

    def _bucket(self, principal: Principal, kind: Kind, rate: Rate) -> _Bucket:
        now, full = self._clock(), max(rate.per_s * BURST_S, 1.0)
        place = (principal.tenant, principal.key_id, kind)
        bucket = self._buckets.get(place)
        if bucket is None:
            bucket = self._buckets[place] = _Bucket(full, now)
            if len(self._buckets) > MOST_KEYS:
                self._buckets.popitem(last=False)
        self._buckets.move_to_end(place)
        bucket.level = min(full, bucket.level + (now - bucket.at) * rate.per_s)
        bucket.at = now
        return bucket
