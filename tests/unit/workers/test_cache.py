"""What a worker keeps, and what leaves when there is no more room."""

from service.workers.cache import Cache


def test_the_longest_unused_value_leaves_and_is_released():
    left = []
    cache = Cache(2, left.append)
    for key in "aba":
        assert cache.get(key, lambda key=key: key.upper()) == key.upper()
    cache.get("c", lambda: "C")
    assert left == ["B"]
    cache.forget("a")
    cache.clear()
    assert left == ["B", "C"]


def test_values_have_room_by_their_bytes_and_the_last_one_in_any_case():
    made = []
    cache = Cache(100, weigh=len, most_bytes=10)

    def get(key, size):
        return cache.get(key, lambda: made.append(key) or "x" * size)

    for key, size in zip("abacabddab", (4, 4, 4, 4, 4, 4, 50, 50, 4, 4), strict=True):
        assert len(get(key, size)) == size
    assert made == ["a", "b", "c", "b", "d", "a", "b"]
    cache.forget("a")
    get("c", 6)
    assert len(get("b", 4)) == 4
    assert made[-1] == "c"
