"""Two models: the demo satellite, and a block with three mirror planes; and answers made by hand."""

import importlib.util

import numpy as np
import pytest

from service.bench.cases import Case, ModelShelf, TruthFrame
from service.inference.pose import exp_so3
from service.inference.state import Estimate, Mode, PoseEstimate, Spread
from service.simulate.glb_writer import SolidNode, write_glb
from service.simulate.primitives import box
from service.simulate.satellite import demo_satellite
from service.workers.tracker import Tracker


@pytest.fixture(scope="session")
def tracker():
    with_device = Tracker()
    yield with_device
    with_device.close()


@pytest.fixture(scope="session")
def shelf(tracker):
    return ModelShelf(tracker)


@pytest.fixture(scope="session")
def satellite(shelf):
    return shelf.model("demo.glb", demo_satellite())


@pytest.fixture(scope="session")
def block(shelf):
    return shelf.model("block.glb", write_glb("block", [SolidNode("block", box((3.0, 2.0, 1.0)))]))


@pytest.fixture(scope="session")
def evaluator(shared):
    """The public evaluator as a module: what it computes is what the rows promise."""
    spec = importlib.util.spec_from_file_location("evaluate", shared / "tools" / "evaluate.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def case_of():
    def make(model, free=(), symmetries=None):
        return Case("made", model, free, (64, 64), list, lambda: iter([]), symmetries)

    return make


@pytest.fixture
def truth():
    return TruthFrame(0.5, exp_so3(np.array([0.3, -0.7, 0.4])), np.array([30.0, 34.0]), 12.0, {}, True)


@pytest.fixture
def answer():
    def make(*poses, weights=None, spread_deg=1.0, joint_deg=1.0):
        """An estimate whose modes are ``poses`` (quaternion, position, scale, joints), the first the best."""
        found = [PoseEstimate(np.asarray(q), np.asarray(p), s, np.asarray(j)) for q, p, s, j in poses]
        joints = np.full(len(found[0].joints), joint_deg)
        width = Spread(spread_deg, 1, 1, 1, 1, 1, 1, joints, np.eye(6))
        shares = weights or [1 / len(found)] * len(found)
        modes = tuple(Mode(w, pose, width) for w, pose in zip(shares, found, strict=True))
        return Estimate("tracking", found[0], found[0], 0.0, width, modes, 10, 5.0, 0.0)

    return make
