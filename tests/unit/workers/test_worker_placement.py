"""Where a session's next job goes: home while that costs nothing, elsewhere rather than wait, never to the lost."""

import pytest

from service.workers.placement import KNOWN_MODELS, Placement


def spread(placement: Placement, sessions: int, model: str = "m") -> list[str]:
    return [placement.take(f"s{n}", model) for n in range(sessions)]


def test_sessions_at_once_are_shared_out_evenly():
    placement = Placement(["a", "b"])
    taken = spread(placement, 16)
    assert taken.count("a") == taken.count("b") == 8
    for worker in taken:
        placement.done(worker)
    again = spread(placement, 16)
    assert abs(again.count("a") - again.count("b")) <= 2
    assert placement.sessions("a") == again.count("a")


def test_idle_worker_takes_over_from_a_busy_one():
    placement = Placement(["a", "b"])
    first = placement.take("s", "m")
    placement.done(first)
    other = next(worker for worker in placement.workers if worker != first)
    for n in range(5):  # the other learns the model while the first is busy
        placement.take(f"t{n}", "m")
    while placement.load(other):
        placement.done(other)
    assert placement.take("s", "m") == other
    assert placement.load(first) > 1


def test_sessions_of_a_model_share_a_worker_only_while_it_has_nothing_to_do():
    placement = Placement(["a", "b"])
    placement.done(placement.take("s", "m"))
    assert [placement.take(name, "m") for name in "tu"] == ["a", "b"]


def test_new_model_goes_where_fewest_are_kept():
    placement = Placement(["a", "b"])
    placement.done(placement.take("s", "m"))
    assert placement.take("t", "n") == "b"


def test_lost_worker_is_left_and_one_begun_anew_knows_no_model():
    placement = Placement(["a", "b"])
    assert placement.take("s", "m") == "a"
    placement.remove("a")
    assert placement.take("s", "m") == "b"
    placement.forget("b")
    placement.add("a")
    placement.done("a")  # the job that it took along ends later
    assert placement.take("t", "m") == "a"
    assert placement.load("a") == 1
    placement.remove("a")
    placement.remove("b")
    with pytest.raises(LookupError):
        placement.take("s", "m")


def test_as_many_models_count_as_known_as_a_worker_keeps():
    placement = Placement(["a"])
    for n in range(KNOWN_MODELS + 1):
        placement.done(placement.take("s", f"m{n}"))
    placement.add("b")
    assert placement.take("t", "m0") == "b"


def test_worker_to_be_avoided_gets_a_job_only_where_it_is_the_last():
    placement = Placement(["a", "b"])
    placement.done(placement.take("s", "m"))
    assert placement.take("s", "m", avoid="a") == "b"
    placement.remove("b")
    assert placement.take("s", "m", avoid="a") == "a"
