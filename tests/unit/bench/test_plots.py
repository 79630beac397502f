"""Groups of passes, and that plots of odd results are drawn at all."""

from dataclasses import replace

import numpy as np
import pytest

from service.bench.plots import _groups, write_plots
from service.bench.runner import CaseResult
from service.bench.scoring import FrameScore
from service.bench.summary import case_row


@pytest.mark.parametrize("x", [np.arange(20.0), np.r_[np.zeros(9), 1.0:12.0], np.zeros(12), np.r_[np.zeros(11), 3.0]])
def test_every_pass_is_in_one_group_and_no_group_is_empty(x):
    groups = _groups(x)
    assert sorted(np.concatenate(groups)) == list(range(len(x)))
    assert all(len(group) for group in groups)
    means = [x[group].mean() for group in groups]
    assert means == sorted(set(means))


@pytest.mark.parametrize("count", [1, 14])
def test_plots_of_few_and_many_passes(tmp_path, count):
    pytest.importorskip("matplotlib")
    seen = FrameScore(0, 0.0, True, "lost", 20.0, 0.0, 0.0, float("nan"), 0.3, 0.4, 0.0, 0.95, 1, None)
    blank = FrameScore(1, 0.1, False, "no_target", 5.0)
    frames = (seen, blank, replace(seen, index=2, time_s=0.2))
    results = [CaseResult("balanced", f"p{k}", frames[: 1 + k % 3], {"snr": 1.0 + k}, 0, "s") for k in range(count)]
    captions = write_plots(results, [case_row(result) for result in results], tmp_path)
    assert sorted(captions) == sorted(path.name for path in tmp_path.iterdir())
    assert "success.png" in captions
