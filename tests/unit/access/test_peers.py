"""Calls between processes: good for one call with one body, once, at one process, for a minute."""

from datetime import UTC, datetime

import pytest

from service.access import peers as module
from service.access.peers import Peers
from service.access.principal import KeyRates, Principal, Role
from service.errors import StaleOwnerError, UnauthorizedError

pytestmark = pytest.mark.anyio
CALLER = Principal("acme", "k1", Role.OPERATE, datetime(2030, 1, 1, tzinfo=UTC), KeyRates(calls_per_s=5.0))
CALL = ("PUT", "/v1/sessions/s/frames/1?time=2026-11-20T03:04:05Z")


class Shared:
    async def write(self, query):
        return "a-secret-of-the-database-they-share-0123456789"


def now():
    return 1_800_000_000.0


@pytest.fixture
async def pair():
    one, two = Peers(Shared(), "one", now), Peers(Shared(), "two", now)
    await one.open()
    await two.open()
    return one, two


async def test_who_calls_and_what_is_carried_over(pair):
    one, two = pair
    assert two.verify(one.sign(CALLER, "two", *CALL, "digest"), *CALL) == (CALLER, "digest")


async def test_a_signature_is_good_once(pair):
    one, two = pair
    token = one.sign(CALLER, "two", *CALL, "digest")
    two.verify(token, *CALL)
    for _ in range(2):
        with pytest.raises(UnauthorizedError):
            two.verify(token, *CALL)
    two.verify(one.sign(CALLER, "two", *CALL, "digest"), *CALL)  # the same call again, signed again


async def test_a_signature_is_of_one_call_at_one_process(pair):
    one, two = pair
    token = one.sign(CALLER, "two", *CALL, "digest")
    for other in (("POST", CALL[1]), (CALL[0], "/v1/sessions/t/frames/1")):
        with pytest.raises(UnauthorizedError):
            two.verify(token, *other)
    with pytest.raises(StaleOwnerError):
        one.verify(token, *CALL)
    assert two.verify(token, *CALL)[0] == CALLER  # a wrong use does not use it up


async def test_nonces_are_remembered_for_as_long_as_their_signatures_are_good_and_no_longer(pair, monkeypatch):
    one, two = pair
    now = 1000.0
    monkeypatch.setattr(module.time, "monotonic", lambda: now)
    for _ in range(3):
        two.verify(one.sign(CALLER, "two", *CALL, "digest"), *CALL)
    assert len(two._used) == 3
    assert min(two._used.values()) - now >= module._GOOD_FOR_S + module._SKEW_S
    now += 3600.0
    two.verify(one.sign(CALLER, "two", *CALL, "digest"), *CALL)
    assert len(two._used) == 1


@pytest.mark.parametrize(("late_s", "good"), [(-25.0, True), (0.0, True), (85.0, True), (95.0, False)])
async def test_a_signature_is_good_for_a_minute_of_the_clock_in_common_whatever_the_machines_say(pair, late_s, good):
    one, _ = pair
    two = Peers(Shared(), "two", lambda: now() + late_s)
    await two.open()
    token = one.sign(CALLER, "two", *CALL, "digest")  # in a year that no machine's own clock shows
    if good:
        assert two.verify(token, *CALL)[0] == CALLER
    else:
        with pytest.raises(UnauthorizedError):
            two.verify(token, *CALL)


async def test_before_the_secret_is_known_nobody_is_believed(pair):
    one, _ = pair
    with pytest.raises(UnauthorizedError):
        Peers(Shared(), "two", now).verify(one.sign(CALLER, "two", *CALL, "digest"), *CALL)
