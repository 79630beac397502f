"""The default scorer: the fastest first, and no frame lost with a device."""

import numpy as np
import pytest
from gpu_cases import a_map, box, mesh_of, transforms

from gpu.auto import AutoScorer
from gpu.errors import DeviceError, DeviceLostError
from gpu.looping import LoopingScorer
from gpu.scorer import open_scorer


class Stub(LoopingScorer):
    """Answers with its number of faces of the dice; slow by doing more, lost on demand."""

    def __init__(self, name, work=0, lost_after=None):
        self.name, self.work, self.left, self.calls, self.closed = name, work, lost_after, 0, False

    def score(self, part_transforms, log_ratio):
        self.calls += 1
        if self.left is not None:
            self.left -= 1
            if self.left < 0:
                raise DeviceLostError(f"{self.name} failed: gone")
        for _ in range(self.work):
            np.linalg.svd(np.ones((60, 60)))
        return np.full(len(part_transforms), 7.0)

    def close(self):
        self.closed = True


POSES, MAP = np.zeros((10, 1, 3, 4), np.float32), np.zeros((4, 4), np.float32)


def never():
    raise AssertionError("opened without need")


def test_the_fastest_device_is_found_once_per_image_size():
    slow, fast = Stub("slow", work=20), Stub("fast")
    scorer = AutoScorer([lambda: slow, lambda: fast, never])
    assert scorer.name == "slow"
    assert scorer.score(POSES, MAP).tolist() == [7.0] * 10
    assert scorer.name == "fast"
    before = slow.calls
    scorer.score(POSES, MAP)
    assert slow.calls == before
    scorer.score(POSES, np.zeros((5, 5), np.float32))
    assert slow.calls > before


def test_one_device_is_not_tried():
    only = Stub("only")
    AutoScorer([lambda: only, never]).score(POSES, MAP)
    assert only.calls == 1


def test_a_lost_device_is_followed_by_the_next_without_losing_the_frame():
    first, second = Stub("first", lost_after=1), Stub("second")
    scorer = AutoScorer([lambda: first, lambda: second])
    scorer.score(POSES, MAP)
    with pytest.warns(RuntimeWarning, match="first failed: gone; going on with second"):
        assert scorer.score(POSES, MAP).tolist() == [7.0] * 10
    assert scorer.score_many(POSES, MAP[None]).shape == (10, 1)


def test_the_last_device_s_loss_is_an_error():
    scorer = AutoScorer([lambda: Stub("only", lost_after=0)])
    with pytest.raises(DeviceLostError, match="only failed"):
        scorer.score(POSES, MAP)
    with pytest.raises(DeviceError, match="no scorer is left"):
        scorer.score(POSES, MAP)


def test_a_device_that_does_not_open_is_passed_over():
    def broken():
        raise DeviceError("driver mismatch")

    with pytest.warns(RuntimeWarning, match="driver mismatch"):
        scorer = AutoScorer([broken, lambda: Stub("second")])
    assert scorer.name == "second"
    with pytest.raises(DeviceError, match="driver mismatch"):
        AutoScorer([broken])


def test_all_are_closed():
    stubs = Stub("a"), Stub("b")
    scorer = AutoScorer([lambda: stubs[0], lambda: stubs[1], never])
    scorer.score(POSES, MAP)
    scorer.close()
    assert all(stub.closed for stub in stubs)


def test_a_real_device_lost_in_the_middle_changes_no_score(monkeypatch):
    import pyopencl as cl

    mesh = mesh_of(box())
    rng = np.random.default_rng(30)
    poses, values = transforms(rng, mesh, 12, 30.0), a_map(rng)
    scorer = open_scorer(mesh)
    before = scorer.score(poses, values)

    def fail(*_args, **_options):
        raise cl.RuntimeError("clEnqueueReadBuffer failed: DEVICE_NOT_AVAILABLE")

    monkeypatch.setattr(cl, "enqueue_copy", fail)
    with pytest.warns(RuntimeWarning, match=r"DEVICE_NOT_AVAILABLE.*going on with") as told:
        after = scorer.score(poses, values)
    assert "numpy:reference" in str(told[-1].message)  # after all devices: a GPU's host may be one as well
    assert np.array_equal(after, before)
