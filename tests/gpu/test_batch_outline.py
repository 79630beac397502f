"""Several frames in one launch: the bits that each would get alone."""

import numpy as np
import pytest
from gpu_cases import SHAPE, a_map, box, mesh_of, sphere, transforms

from gpu.batch import BatchOutline, Question
from gpu.device import find_devices
from gpu.errors import ScorerError
from gpu.outline import OutlineScorer
from gpu.prefix import fixed_point_prefix

KERNELS = ("cpu", "gpu")


@pytest.fixture
def device():
    usable = [report for report in find_devices() if report.rejected is None]
    if not usable:
        pytest.skip("no OpenCL device answers")
    return usable[0]


class Frames:
    """Frames with their own maps and particles, each scored alone too."""

    def __init__(self, mesh, device, kernel, sizes, shape=SHAPE, n_maps=1, radius_px=25.0, seed=3):
        rng, alone = np.random.default_rng(seed), OutlineScorer(mesh, device, kernel)
        self.maps = [np.stack([a_map(rng, shape) * (k + 1) for _ in range(n_maps)]) for k in range(len(sizes))]
        self.particles = [transforms(rng, mesh, n, radius_px, shape) for n in sizes]
        self.expected = [alone.score_many(t, m) for t, m in zip(self.particles, self.maps, strict=True)]
        alone.close()

    def ask(self, batch):
        units, questions = [], []
        for maps, particles in zip(self.maps, self.particles, strict=True):
            slot = batch.take_slot()
            prefix, unit = fixed_point_prefix(maps)
            batch.put(slot, prefix)
            units.append(unit)
            questions.append(Question(slot, particles))
        return questions, units

    def same_bits(self, scores, units):
        found = [whole * unit for whole, unit in zip(scores, units, strict=True)]
        return all(np.array_equal(one, other) for one, other in zip(found, self.expected, strict=True))


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("n_maps", [1, 3])
def test_frames_of_one_shape_are_one_launch(device, kernel, n_maps):
    mesh = mesh_of(sphere(), box(centre=(1.5, 0, 0)))
    frames = Frames(mesh, device, kernel, (40, 1, 150, 7, 64), n_maps=n_maps)
    batch = BatchOutline(mesh, device, kernel)
    questions, units = frames.ask(batch)
    assert frames.same_bits(batch.score(questions), units)
    assert batch.launches == 1
    order = [3, 0, 4, 1, 2]  # whoever is scored beside it
    mixed = batch.score([questions[k] for k in order])
    assert frames.same_bits([mixed[order.index(k)] for k in range(5)], units)
    batch.close()


@pytest.mark.parametrize("kernel", KERNELS)
def test_frames_of_two_sizes_and_a_slot_with_new_maps(device, kernel):
    mesh = mesh_of(box())
    batch = BatchOutline(mesh, device, kernel)
    small = Frames(mesh, device, kernel, (20, 30))
    large = Frames(mesh, device, kernel, (25, 5), shape=(130, 150), seed=4)
    (questions, units), (others, other_units) = small.ask(batch), large.ask(batch)
    scores = batch.score([questions[0], others[0], others[1], questions[1]])
    assert small.same_bits([scores[0], scores[3]], units)
    assert large.same_bits(scores[1:3], other_units)
    assert batch.launches == 2
    later = Frames(mesh, device, kernel, (20, 30), seed=5)
    for question, maps in zip(questions, later.maps, strict=True):
        batch.put(question.slot, fixed_point_prefix(maps)[0])
    again = [Question(q.slot, t) for q, t in zip(questions, later.particles, strict=True)]
    assert later.same_bits(batch.score(again), [fixed_point_prefix(maps)[1] for maps in later.maps])
    batch.close()


def test_particles_without_room_are_scored_with_their_own_maps(device, monkeypatch):
    mesh = mesh_of(sphere())
    frames = Frames(mesh, device, "cpu", (3, 4))
    batch = BatchOutline(mesh, device, "cpu")
    questions, units = frames.ask(batch)
    monkeypatch.setattr("gpu.batch.unresolved", lambda scores: np.array([1, 3, 6]))  # as if these had had none
    monkeypatch.setattr(batch._by_item, "score", spoiling(batch._by_item.score))
    assert not frames.same_bits(batch.score(questions), units)
    monkeypatch.setattr("gpu.batch.unresolved", lambda scores: np.arange(7))
    assert frames.same_bits(batch.score(questions), units)
    batch.close()


def spoiling(score):
    """The kernel for CPUs with every particle moved: only what is scored again can be right."""

    def moved(transforms, n, prefix, n_maps, shape, out, places):
        score(transforms, n, prefix, n_maps, (shape[0] - 1, shape[1]), out, places)

    return moved


def test_slots_are_used_again_and_empty_ones_refused(device):
    batch = BatchOutline(mesh_of(box()), device)
    first, second = batch.take_slot(), batch.take_slot()
    assert (first, second) == (0, 1)
    batch.drop_slot(first)
    assert batch.take_slot() == first
    with pytest.raises(ScorerError, match="no maps"):
        batch.score([Question(first, np.zeros((1, 1, 3, 4), np.float32))])
    batch.close()
