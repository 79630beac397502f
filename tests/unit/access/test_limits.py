"""Rates of a key: buckets that fill with time, by a clock of the test's own."""

import pytest

from service.access.limits import MEGAPIXEL, MOST_KEYS, Limits
from service.access.principal import LOCAL, KeyRates, Principal, Role
from service.errors import ConfigError, RateLimitedError
from service.settings import Settings

ANOTHER = Principal("acme", "k", Role.OPERATE)


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def limits(**settings: float) -> tuple[Limits, Clock]:
    clock = Clock()
    return Limits(Settings(**settings), clock), clock


def test_calls_are_let_through_at_the_rate():
    bucket, clock = limits(rate_calls_per_s=10)
    passed = 0
    for _ in range(1000):  # for ten seconds, ten times as many as allowed
        clock.now += 0.01
        try:
            bucket.check(LOCAL, "calls")
        except RateLimitedError as error:
            assert error.facts == {"limit": 10, "setting": "SKYPOSE_RATE_CALLS_PER_S", "retry_after_s": 1}
            continue
        bucket.take(LOCAL, "calls", 1)
        passed += 1
    assert 100 <= passed <= 122  # ten a second, and the two seconds' worth saved before


def test_one_large_thing_passes_and_is_paid_for_afterwards():
    bucket, clock = limits(rate_megapixels_per_s=1)
    bucket.check(LOCAL, "pixels")
    bucket.take(LOCAL, "pixels", 12 * MEGAPIXEL)
    with pytest.raises(RateLimitedError) as refusal:
        bucket.check(LOCAL, "pixels")
    assert refusal.value.facts["retry_after_s"] == 10
    clock.now += 10.1
    bucket.check(LOCAL, "pixels")


def test_keys_do_not_share():
    bucket, _ = limits(rate_megabytes_per_s=1)
    bucket.take(LOCAL, "bytes", 1e9)
    bucket.check(ANOTHER, "bytes")
    bucket.check(LOCAL, "calls")
    with pytest.raises(RateLimitedError):
        bucket.check(LOCAL, "bytes")


def test_zero_is_no_limit():
    bucket, _ = limits(rate_calls_per_s=0)
    for _ in range(10):
        bucket.take(LOCAL, "calls", 1e9)
        bucket.check(LOCAL, "calls")


def test_memory_is_bounded():
    bucket, _ = limits()
    for n in range(MOST_KEYS + 10):
        bucket.check(Principal("acme", str(n), Role.READ), "calls")
    assert len(bucket._buckets) == MOST_KEYS


def test_a_key_has_rates_of_its_own():
    bucket, clock = limits(rate_calls_per_s=1000, rate_megapixels_per_s=1)
    slow = Principal("acme", "slow", Role.OPERATE, rates=KeyRates(calls_per_s=1, megapixels_per_s=0))
    bucket.take(slow, "calls", 3)
    with pytest.raises(RateLimitedError) as refusal:
        bucket.check(slow, "calls")
    assert refusal.value.facts == {"limit": 1, "setting": "calls_per_s of the key", "retry_after_s": 1}
    bucket.take(slow, "pixels", 1e12)
    bucket.check(slow, "pixels")  # 0: any amount
    bucket.take(ANOTHER, "calls", 3)
    bucket.check(ANOTHER, "calls")
    clock.now += 1.5
    bucket.check(slow, "calls")


@pytest.mark.parametrize("rate", [0.0, 1001.0])
def test_a_tenant_cannot_give_itself_more_than_the_settings(rate):
    bucket, _ = limits(rate_calls_per_s=1000)
    with pytest.raises(ConfigError) as refusal:
        bucket.require_grantable(ANOTHER, KeyRates(calls_per_s=rate))
    assert refusal.value.facts == {"limit": 1000, "setting": "SKYPOSE_RATE_CALLS_PER_S"}
    bucket.require_grantable(ANOTHER, KeyRates(calls_per_s=1000.0))
    bucket.require_grantable(LOCAL, KeyRates(calls_per_s=rate))
