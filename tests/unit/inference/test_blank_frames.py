"""Nothing shows any more, after few frames or many: there is no target, whatever was followed."""

import pytest
from test_light_filter import advance, frame


@pytest.mark.parametrize("before", [1, 4, 6, 8])
def test_the_first_empty_frame_says_that_there_is_no_target(before):
    """A search may have missed the truth; but where no light is left, none of the body's is, either."""
    state = None
    for k in range(before + 1):
        state, estimate = advance(state, frame(k, 700.0 if k < before else 0.0), k)
    assert estimate.status == "no_target" and estimate.probabilities[0] > 0.99
