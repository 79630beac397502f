"""The line of frames that wait: full for whoever fills it."""

import pytest

from service.errors import BusyError, InboxFullError
from service.sessions.line import Line


def filled(line: Line, tenant: str) -> int:
    """How many more of a tenant's frames find room."""
    count = 0
    while True:
        try:
            line.require_room(tenant, 0)
        except BusyError:
            return count
        line.enter(tenant)
        count += 1


def test_a_tenant_alone_may_have_all_places_and_another_still_finds_its_share():
    line = Line(4, 12)
    assert filled(line, "hostile") == 12
    assert filled(line, "good") == 6
    assert filled(line, "third") == 4
    assert filled(line, "good") == 0
    for _ in range(12):
        line.leave("hostile")
    assert filled(line, "good") == 2  # ten are left of the others, and twelve may wait


def test_a_session_has_its_own_bound():
    with pytest.raises(InboxFullError):
        Line(4, 12).require_room("good", 4)
