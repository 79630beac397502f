"""Sessions that an earlier version stored are read; what is sent now is held to what there is."""

import pytest

from service.errors import ConfigError
from service.sessions.config import document, effective, stored, unused, without_retired


def test_what_is_no_more_is_left_out_of_what_was_stored():
    old = document(effective({"filter": {"particles": 300}}))
    old["filter"] |= {"method": "tempered", "target_ess": 0.5, "moves": 6, "acquisition_moves": 4}
    old["likelihood"] |= {"kind": "contrast", "exponent": 0.05}
    read = stored(old)
    assert (read.filter.method, read.filter.particles) == ("auto", 300)
    assert old["filter"]["moves"] == 6  # what was handed in stays as it was


def test_what_is_no_more_is_told():
    sections, said = without_retired({"filter": {"prefer": "weight", "method": "importance", "seed": 2}, "motion": {}})
    assert sections == {"filter": {"method": "auto", "seed": 2}, "motion": {}}
    assert said == ("filter.prefer is no more, and was left out", "filter.method importance is no more: auto")


@pytest.mark.parametrize(
    ("sent", "said"),
    [
        ({"filter": {"backend": "cpu", "seed": 1}}, ("filter.backend is for bootstrap, and is not used",)),
        ({"filter": {"preset": "paper", "backend": "cpu"}}, ()),
        ({}, ()),
    ],
)
def test_what_the_method_does_not_use_is_told(sent, said):
    assert unused(sent, effective(sent)) == said


@pytest.mark.parametrize("sent", [{"method": "tempered"}, {"moves": 6}])
def test_what_is_no_more_is_refused_with_a_name(sent):
    with pytest.raises(ConfigError, match=r"filter\." + next(iter(sent))):
        effective({"filter": sent})


def test_what_was_stored_is_read_as_it_is():
    config = effective({"camera": {"transfer": 0.45, "background": "auto"}})
    assert stored(document(config)) == config
