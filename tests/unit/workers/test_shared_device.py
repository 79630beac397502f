"""A device that several workers share: the bits that each would get alone, in fewer launches, whoever owns it dies."""

import os
import pickle
import signal
import socket
from multiprocessing.connection import Connection

import numpy as np
import pytest

from gpu.device import find_devices
from gpu.errors import DeviceError
from gpu.mesh import load_mesh
from gpu.prefix import fixed_point_prefix
from gpu.scorer import open_scorer
from service.inference.articulation import part_transforms
from service.inference.pose import retract
from service.inference.state import Poses
from service.simulate.satellite import demo_satellite
from service.workers.device_owner import DeviceOwner, shared_device
from service.workers.device_process import DeviceProcess
from service.workers.scoring import Scorers
from service.workers.shared_scorer import MOST_PARTICLES, SharedScorer, open_shared
from service.workers.tracker import Tracker


@pytest.fixture(scope="module")
def owner():
    process = DeviceProcess(any_kind=True, nice=0)
    process.start()
    yield process
    process.close()


@pytest.fixture(scope="module")
def mesh():
    return load_mesh(demo_satellite(), "glb")


def a_frame(demo, mesh, seed, n=60):
    """Particles about one pose, and a map."""
    rng, articulation = np.random.default_rng(seed), demo.report.articulation
    one = Poses(np.array([[1.0, 0, 0, 0]]), np.array([[32.0, 32.0]]), np.array([1.5]), articulation.initial[None])
    poses = retract(Poses(*(np.repeat(a, n, axis=0) for a in vars(one).values())), rng.normal(size=(n, 7)) * 0.3)
    maps = rng.normal(size=(1, 64, 64)).astype(np.float32)
    maps.flags.writeable = False
    return part_transforms(articulation, poses), maps


def test_scores_have_the_same_bits(demo, owner, mesh):
    shared, alone = SharedScorer(owner.address, "body", mesh), open_scorer(mesh)
    for seed in (1, 2):
        transforms, maps = a_frame(demo, mesh, seed)
        for some in (transforms, transforms[:1], transforms[:0]):
            assert np.array_equal(shared.score_many(some, maps), alone.score_many(some, maps))
            assert np.array_equal(shared.score(some, maps[0]), alone.score(some, maps[0]))
    assert shared.name == alone.name
    shared.close()
    alone.close()


def test_track_has_the_same_bits(demo, owner):
    alone, shared = Tracker(), Tracker(opener=open_shared(owner.address))
    (expected, names), (report, others) = (demo.track(t, "auto", method="bootstrap") for t in (alone, shared))
    assert np.array_equal(report.state.poses.quaternion, expected.state.poses.quaternion)
    assert np.array_equal(report.state.log_weights, expected.state.log_weights)
    assert (report.estimate.log_evidence, names) == (expected.estimate.log_evidence, others)
    alone.close()
    shared.close()


def test_what_is_asked_at_one_time_is_one_launch(demo, mesh):
    """Three guests, two of the same mesh: their questions lie there when the owner looks."""
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind("")  # a name of the kernel's choice
        listener.listen()
        owner = DeviceOwner(listener, shared_device(any_kind=True))
        guests = [guest_of(listener.getsockname()) for _ in range(3)]
        for guest, model in zip(guests, ("one", "one", "two"), strict=True):
            ask(guest, "open", model)
            if served(owner, guest) is None:
                ask(guest, "mesh", mesh)
                served(owner, guest)
        frames = [a_frame(demo, mesh, seed) for seed in range(3)]
        for guest, (transforms, maps) in zip(guests, frames, strict=True):
            ask(guest, "score", fixed_point_prefix(maps)[0], transforms)
        owner.turn()
        alone = open_scorer(mesh)
        for guest, (transforms, maps) in zip(guests, frames, strict=True):
            unit = fixed_point_prefix(maps)[1]
            assert np.array_equal(answer(guest) * unit, alone.score_many(transforms, maps))
        assert (owner.questions, owner.launches) == (3, 2)
        guests[0].close()
        owner.turn()  # it has left; the other goes on
        ask(guests[1], "score", None, frames[1][0])
        assert len(served(owner, guests[1])) == 60
        for guest in guests[1:]:
            guest.close()


def guest_of(address) -> Connection:
    end = socket.socket(socket.AF_UNIX)
    end.connect(address)
    return Connection(end.detach())


def ask(guest: Connection, *message) -> None:
    guest.send_bytes(pickle.dumps(message))


def served(owner: DeviceOwner, guest: Connection):
    while not guest.poll():
        owner.turn()
    return answer(guest)


def answer(guest: Connection):
    error, found = pickle.loads(guest.recv_bytes())
    assert error is None
    return found


def test_owner_that_dies_costs_no_frame(demo):
    process = DeviceProcess(any_kind=True, nice=0)
    process.start()
    tracker = Tracker(opener=open_shared(process.address))
    expected, _ = demo.track(Tracker(), "auto")
    first = tracker.track(demo.job("auto"))
    os.kill(process.describe()["pid"], signal.SIGKILL)
    with pytest.warns(RuntimeWarning, match="owner is gone"):
        second = tracker.track(demo.job("auto", 1, first.state))
    third = tracker.track(demo.job("auto", 2, second.state))
    assert np.array_equal(third.state.log_weights, expected.state.log_weights)
    tracker.close()
    process.close()
    assert process.restarts <= 1


def test_without_a_device_worth_sharing_workers_use_their_own(demo, mesh):
    if any(report.kind == "gpu" and report.rejected is None for report in find_devices()):
        pytest.skip("this machine has a GPU to share")
    process = DeviceProcess(any_kind=False, nice=0)
    process.start()
    scorer = open_shared(process.address)("body", "auto", mesh)  # waits in the queue until the owner has looked
    transforms, maps = a_frame(demo, mesh, 1)
    assert len(scorer.score_many(transforms, maps)) == len(transforms)
    scorer.close()
    process.close()
    with pytest.raises(DeviceError):
        SharedScorer(process.address, "body", mesh)


def test_sessions_that_fill_a_device_keep_their_own_scorer(mesh):
    opened = []

    def opener(model, backend, mesh):
        opened.append(backend)
        return open_scorer(mesh, backend="reference")

    scorers = Scorers(4, opener=opener)
    with scorers.lend("body", "reference", mesh, MOST_PARTICLES - 1):
        assert opened == ["reference"]
    with scorers.lend("body", "reference", mesh, MOST_PARTICLES):
        assert opened == ["reference"]
    scorers.close()
