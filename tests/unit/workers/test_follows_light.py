"""Which frames are those of the filter of modes."""

from dataclasses import replace

import numpy as np
import pytest
from test_restored_mixture import MIXTURE, state

from service.sessions.config import effective
from service.workers.base import FrameJob
from service.workers.following import follows_light

BEGUN = state(MIXTURE)
BY_OUTLINE = replace(BEGUN, mixture=None, memory={"psf": np.ones(1)})
UNSEEN = replace(BEGUN, mixture=None)


def job(chosen: dict, **others) -> FrameJob:
    given = dict.fromkeys(FrameJob.__dataclass_fields__) | {"compared": False} | others
    return FrameJob(**given | {"config": effective({"filter": chosen})})


@pytest.mark.parametrize(
    ("chosen", "others", "wanted"),
    [
        ({}, {}, True),
        ({}, {"state": BEGUN}, True),
        ({}, {"state": UNSEEN}, True),
        ({}, {"state": BY_OUTLINE}, False),
        ({}, {"compared": True}, False),
        ({"backend": "cpu"}, {}, False),
        ({"method": "mixture", "backend": "cpu"}, {"state": BY_OUTLINE}, True),
        ({"method": "importance"}, {}, False),
        ({"preset": "paper"}, {}, False),
    ],
)
def test_a_session_goes_on_as_it_began_and_as_it_asks(chosen, others, wanted):
    assert follows_light(job(chosen, **others)) is wanted
