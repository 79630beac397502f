"""How often the whole space is searched: as likely as it is that the truth was missed (docs/model.md, section 6)."""

from dataclasses import replace

import pytest
from held_mixture import mixture

from service.inference.filters.effort import frames_between, part_due
from service.inference.model.existence import missed
from service.inference.model.stages import WHOLE, Part


def search_due(before) -> bool:
    """Whether a whole search ends with this frame."""
    part = part_due(before, 1)
    return part is not None and part.is_last


@pytest.mark.parametrize("nats", [50.0, 200.0, 530.0, 2000.0])
@pytest.mark.parametrize("misses", [0, 1])
def test_a_search_is_due_where_it_may_put_right_what_it_is_worth(nats, misses):
    """Once for each so many wrong answers that it is expected to save: those since the last, were it to meet a truth
    that all before have missed."""
    for searches in range(4, 40):
        held = replace(mixture(searches=searches, misses=misses), searched_nats=nats)
        before, after = (missed(searches + more, misses, nats=nats) for more in (0, 1))
        between, gain = frames_between(held), before - after
        assert 9 <= between <= 1000
        assert between == 9 or between * gain <= 0.15
        assert between == 1000 or (between + 1) * gain > 0.15


def test_a_track_that_no_search_could_better_is_searched_ever_more_seldom():
    for nats in (50.0, 200.0, 530.0, 2000.0):
        between = [frames_between(replace(mixture(searches=n), searched_nats=nats)) for n in range(4, 300)]
        assert between == sorted(between) and between[-1] > between[0]


def test_of_a_bright_body_a_search_has_less_to_put_right():
    between = [frames_between(replace(mixture(searches=4), searched_nats=nats)) for nats in (200.0, 340.0, 530.0, 1e3)]
    assert between == sorted(set(between)) and between[0] == 9
    known_to_miss = [frames_between(replace(mixture(searches=4, misses=m), searched_nats=1e3)) for m in (0, 1)]
    assert known_to_miss[1] < 0.2 * known_to_miss[0]


def test_a_track_is_settled_after_four_searches():
    last = frames_between(mixture(searches=4)) - 1
    due = [search_due(replace(mixture(searches=n), since_search=k)) for n in (1, 4) for k in (0, last - 1, last)]
    assert due == [True] * 3 + [False, False, True]


def test_a_bright_body_that_is_resolved_is_searched_twice_at_once():
    """What a search may have missed decides how many follow: of little light, blurred, or doubted, four."""
    sure = replace(mixture(searches=2, ever=True), searched_nats=5000.0, span_px=80.0)
    assert not search_due(sure) and search_due(replace(sure, searches=1))
    assert [search_due(replace(sure, since_search=k)) for k in (8, frames_between(sure) - 1)] == [False, True]
    changes = {"searched_nats": 300.0}, {"span_px": 20.0}, {"ever_tracked": False}, {"misses": 1}, {"discrepancy": 0.06}
    assert all(search_due(replace(sure, **change)) for change in changes)


def test_what_searches_have_missed_before_and_what_fits_no_more_is_searched_more_often():
    missed = [search_due(replace(mixture(searches=6, misses=m), since_search=k)) for m in (2, 3) for k in (1, 2)]
    assert missed == [False, False, False, True]
    gone = mixture(existence=(0.0, 0.2, 0.8), searches=30)
    assert [search_due(replace(gone, since_search=k)) for k in (0, 1, 2)] == [False, False, True]


@pytest.mark.parametrize("nats", [200.0, 340.0, 530.0, 2000.0])
def test_a_settled_track_is_searched_part_after_part_over_the_frames_between(nats):
    """Every third frame has one, or fewer where there are more than twelve such; whole it is with the last."""
    held, parts = replace(mixture(searches=4), searched_nats=nats), []
    between = frames_between(held)
    for since in range(between):
        part = part_due(replace(held, since_search=since, parts_searched=len(parts)))
        parts += [] if part is None else [part]
    assert parts == [Part(k, min(between // 3, 12)) for k in range(min(between // 3, 12))]
    assert part_due(replace(held, since_search=between - 2, parts_searched=len(parts) - 1)) is None
    few = replace(held, since_search=between - 1, parts_searched=2)
    assert part_due(few, most_parts=3) == Part(2, 3)


def test_what_a_track_may_have_missed_is_not_put_off():
    for held in (None, mixture(searches=1), replace(mixture(existence=(0.0, 0.2, 0.8), searches=30), since_search=2)):
        assert part_due(held) == WHOLE
    assert part_due(replace(mixture(existence=(0.9, 0.1, 0.0)), since_search=1)) == WHOLE


def test_parts_of_another_plan_do_not_go_on_beyond_the_last():
    """What was learnt since may ask for another search than the one that was under way."""
    held = replace(mixture(searches=4), searched_nats=200.0, since_search=8)
    assert part_due(replace(held, parts_searched=5)) == Part(2, 3)
