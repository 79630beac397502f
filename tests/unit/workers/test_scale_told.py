"""What is told of the scale against what is seen: a body far too large is refused, and light tells its extent."""

from dataclasses import replace

import pytest

from service.errors import ConfigError
from service.inference.params import CameraParams
from service.workers.full_frame import in_full_frame


@pytest.mark.parametrize("method", ["bootstrap", "auto"])
def test_a_body_far_larger_than_the_image_is_refused(demo, tracker, method):
    job = replace(demo.job("auto", method=method), scale_px=(1e4, 1.2e4))
    with pytest.raises(ConfigError, match=r"px across, in an image of 64 x 64: .*prior\.unit_m") as refused:
        tracker.track(job)
    assert refused.value.field == "prior"


def test_the_extent_of_the_light_is_told_as_a_scale(demo, tracker):
    estimate = tracker.track(demo.job("auto", method="auto")).estimate
    assert estimate.light_scale is not None
    assert 0.3 * estimate.best.scale < estimate.light_scale < 1.1 * estimate.best.scale
    binned = in_full_frame(estimate, CameraParams(binning=2))
    assert binned.light_scale == 2 * estimate.light_scale
