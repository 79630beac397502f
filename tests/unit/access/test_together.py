"""Questions that go together: no more of them than fit, each name answered, nobody hurt by another's going."""

import asyncio

import pytest

from service.access.together import Together

pytestmark = pytest.mark.anyio


class Slow:
    """Knows names that begin with a vowel; answers when it is let."""

    def __init__(self) -> None:
        self.asked: list[list[str]] = []
        self.let = asyncio.Event()
        self.let.set()

    async def __call__(self, names):
        self.asked.append(list(names))
        await self.let.wait()
        if "fails" in names:
            raise OSError("gone")
        return {name: name.upper() for name in names if name[0] in "aeiou"}


async def test_a_flood_is_one_question_and_each_name_is_answered():
    slow = Slow()
    together = Together(slow, apart_s=0.0)
    names = [f"{'ax'[k % 2]}{k % 7}" for k in range(1000)]
    answers = await asyncio.gather(*(together.get(name) for name in names))
    assert answers == [name.upper() if name[0] == "a" else None for name in names]
    assert slow.asked == [sorted(set(names))]


async def test_the_next_question_waits():
    slow = Slow()
    together = Together(slow, apart_s=3600.0)
    assert await together.get("one") == "ONE"
    waiting = asyncio.create_task(together.get("a"))
    for _ in range(100):
        await asyncio.sleep(0)
    assert slow.asked == [["one"]]
    waiting.cancel()


async def test_who_comes_while_one_is_under_way_is_asked_for_next():
    slow = Slow()
    slow.let.clear()
    together = Together(slow, apart_s=0.0)
    first = asyncio.create_task(together.get("a"))
    while not slow.asked:
        await asyncio.sleep(0)
    second = asyncio.create_task(together.get("e"))
    while len(slow.asked) < 2:
        await asyncio.sleep(0)
    slow.let.set()
    assert await asyncio.gather(first, second) == ["A", "E"]
    assert slow.asked == [["a"], ["e"]]


async def test_who_gives_up_takes_nobody_along():
    slow = Slow()
    slow.let.clear()
    together = Together(slow, apart_s=0.0)
    gone, stays = (asyncio.create_task(together.get(name)) for name in ("a", "e"))
    while not slow.asked:
        await asyncio.sleep(0)
    gone.cancel()
    slow.let.set()
    assert await stays == "E"
    with pytest.raises(asyncio.CancelledError):
        await gone


async def test_a_failure_is_that_of_all_who_asked_and_the_next_is_asked_anew():
    together = Together(Slow(), apart_s=0.0)
    answers = await asyncio.gather(together.get("fails"), together.get("a"), return_exceptions=True)
    assert [type(answer) for answer in answers] == [OSError, OSError]
    assert await together.get("a") == "A"
