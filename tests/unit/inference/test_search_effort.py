"""How often the whole space is searched: as likely as it is that the truth was missed (docs/model.md, section 6)."""

from dataclasses import replace

from held_mixture import mixture

from service.inference.filters.effort import part_due
from service.inference.model.stages import WHOLE, Part


def search_due(before) -> bool:
    """Whether a whole search ends with this frame."""
    part = part_due(before, 1)
    return part is not None and part.is_last


def test_a_track_that_no_search_could_better_is_searched_ever_more_seldom():
    due = [search_due(replace(mixture(searches=n), since_search=k)) for n in (1, 4, 5, 6) for k in (0, 1, 7, 8)]
    assert due == [True] * 4 + [False, False, False, True] + [False] * 8


def test_a_bright_body_that_is_resolved_is_searched_twice_at_once():
    """What a search may have missed decides how many follow: of little light, blurred, or doubted, four."""
    sure = replace(mixture(searches=2, ever=True), searched_nats=5000.0, span_px=80.0)
    assert not search_due(sure) and search_due(replace(sure, searches=1))
    assert [search_due(replace(sure, since_search=k)) for k in (7, 8)] == [False, True]
    assert [search_due(replace(sure, searches=3, since_search=k)) for k in (8, 25, 26)] == [False, False, True]
    changes = {"searched_nats": 300.0}, {"span_px": 20.0}, {"ever_tracked": False}, {"misses": 1}, {"discrepancy": 0.06}
    assert all(search_due(replace(sure, **change)) for change in changes)


def test_what_searches_have_missed_before_and_what_fits_no_more_is_searched_more_often():
    missed = [search_due(replace(mixture(searches=6, misses=m), since_search=k)) for m in (2, 3) for k in (1, 2)]
    assert missed == [False, False, False, True]
    gone = mixture(existence=(0.0, 0.2, 0.8), searches=30)
    assert [search_due(replace(gone, since_search=k)) for k in (0, 1, 2)] == [False, False, True]


def test_a_settled_track_is_searched_part_after_part_over_the_frames_between():
    """Over ever more of them, 100 at the most; whole it is with the last."""
    for searches, between, count in ((4, 9, 3), (5, 27, 9), (6, 81, 12), (7, 100, 12), (9, 100, 12)):
        held, parts = mixture(searches=searches), []
        for since in range(between):
            part = part_due(replace(held, since_search=since, parts_searched=len(parts)))
            parts += [] if part is None else [part]
        assert parts == [Part(k, count) for k in range(count)]
        assert part_due(replace(held, since_search=between - 2, parts_searched=len(parts) - 1)) is None
    assert part_due(replace(mixture(searches=5), since_search=26, parts_searched=2), most_parts=3) == Part(2, 3)


def test_what_a_track_may_have_missed_is_not_put_off():
    for held in (None, mixture(searches=1), replace(mixture(existence=(0.0, 0.2, 0.8), searches=30), since_search=2)):
        assert part_due(held) == WHOLE
    assert part_due(replace(mixture(existence=(0.9, 0.1, 0.0)), since_search=1)) == WHOLE


def test_parts_of_another_plan_do_not_go_on_beyond_the_last():
    """What was learnt since may ask for another search than the one that was under way."""
    assert part_due(replace(mixture(searches=4), since_search=8, parts_searched=5)) == Part(2, 3)
