"""The hub against a log that others write too: nothing is lost, repeated, or said twice."""

import pytest

from service.sessions.hub import Hub
from service.store import frames
from service.store.base import StoredEvent
from service.store.signals import Signal

pytestmark = pytest.mark.anyio


class Log:
    """The event log, as far as it is committed."""

    def __init__(self) -> None:
        self.newest = 0
        self.told: list[Signal] = []

    def tell(self, signal):
        self.told.append(signal)

    async def read(self, function, session_id, *args):
        if function is frames.last_seq:
            return self.newest
        if function is frames.last_seqs:
            return {"s": self.newest} if self.newest is not None else {}
        after, limit = args
        return [StoredEvent(seq, b"%d" % seq) for seq in range(after + 1, self.newest + 1)][:limit]


@pytest.fixture
def log():
    return Log()


@pytest.fixture
def hub(log):
    return Hub(log, ring=8, max_lag=100, heartbeat_s=0.01, max_watchers=10)


def commit(log: Log, hub: Hub) -> None:
    log.newest += 1
    hub.publish("s", log.newest, b"%d" % log.newest)


async def estimates(messages, count: int) -> list[int]:
    found = []
    async for message in messages:
        if message.type != "heartbeat":
            assert message.type == "estimate"
            found.append(message.seq)
        if len(found) == count:
            return found
    raise AssertionError("ended")


async def test_a_watcher_that_comes_between_commit_and_publication(log, hub):
    async with hub.watch("s", 0) as first:
        commit(log, hub)
        assert await estimates(first, 1) == [1]
        log.newest = 2  # committed, not yet published
        async with hub.watch("s", 1) as second:
            assert await estimates(second, 1) == [2]
        hub.publish("s", 2, b"2")
        assert await estimates(first, 1) == [2]


async def test_another_process_writes_in_between(log, hub):
    async with hub.watch("s", 0) as messages:
        commit(log, hub)
        assert await estimates(messages, 1) == [1]
        log.newest = 3
        hub.grown("s", 3)
        hub.publish("s", 2, b"2")  # ours, told late: the process was stopped after its commit
        assert await estimates(messages, 2) == [2, 3]
        hub.grown("s", 2)  # told late, too
        log.newest = 5  # 4 was written elsewhere, and that is not heard yet
        hub.publish("s", 5, b"5")
        assert await estimates(messages, 2) == [4, 5]


async def test_what_was_not_heard_is_read(log, hub):
    async with hub.watch("s", None) as messages:
        log.newest = 2
        await hub.look_again()
        assert await estimates(messages, 2) == [1, 2]
        log.newest = None
        await hub.look_again()
        assert [message.reason async for message in messages if message.type == "end"] == ["deleted"]


async def test_what_is_committed_here_is_told_to_the_others(log, hub):
    commit(log, hub)
    assert log.told == [Signal("grown", "s", 1)]


async def test_a_signal_that_is_too_late_is_not_believed(log, hub):
    async with hub.watch("s", 0) as messages:
        commit(log, hub)
        hub.grown("s", 9)  # of the session as it was before it was deleted and put back
        assert await estimates(messages, 1) == [1]
        assert (await anext(messages)).type == "heartbeat"  # the log is not read over and over for what is not there
        commit(log, hub)
        assert await estimates(messages, 1) == [2]
