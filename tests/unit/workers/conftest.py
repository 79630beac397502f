import pytest
from demo_jobs import DemoPass

from gpu.device import find_devices
from service.workers.tracker import Tracker


@pytest.fixture(scope="module")
def demo():
    """A few frames, where there is a device to track them on."""
    if all(report.rejected for report in find_devices()):
        pytest.skip("no OpenCL device answers")
    return DemoPass()


@pytest.fixture
def tracker():
    opened = Tracker()
    yield opened
    opened.close()
