"""How often the whole space is searched: as likely as it is that the truth was missed (docs/model.md, section 6)."""

from dataclasses import replace

from held_mixture import mixture

from service.inference.filters.mixture import search_due


def test_a_track_that_no_search_could_better_is_searched_ever_more_seldom():
    due = [search_due(replace(mixture(searches=n), since_search=k)) for n in (1, 4, 5, 6) for k in (0, 1, 2, 8)]
    assert due == [True] * 4 + [False, False, True, True] + [False, False, False, True] + [False] * 4


def test_a_bright_body_that_is_resolved_is_searched_twice_at_once():
    """What a search may have missed decides how many follow: of little light, blurred, or doubted, four."""
    sure = replace(mixture(searches=2, ever=True), searched_nats=5000.0, span_px=80.0)
    assert not search_due(sure) and search_due(replace(sure, searches=1))
    assert [search_due(replace(sure, since_search=k)) for k in (1, 2)] == [False, True]
    assert [search_due(replace(sure, searches=3, since_search=k)) for k in (2, 7, 8)] == [False, False, True]
    changes = {"searched_nats": 300.0}, {"span_px": 20.0}, {"ever_tracked": False}, {"misses": 1}, {"discrepancy": 0.06}
    assert all(search_due(replace(sure, **change)) for change in changes)


def test_what_searches_have_missed_before_and_what_fits_no_more_is_searched_more_often():
    missed = [search_due(replace(mixture(searches=6, misses=m), since_search=k)) for m in (2, 3) for k in (1, 2)]
    assert missed == [False, False, False, True]
    gone = mixture(existence=(0.0, 0.2, 0.8), searches=30)
    assert [search_due(replace(gone, since_search=k)) for k in (0, 1, 2)] == [False, False, True]
