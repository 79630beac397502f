"""What all tests share: where the data outside the repository lies, and settings of the test tools."""

import os
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
from hypothesis import settings
from postgres_server import Postgres

from service.workers.interpreter import use_one_blas_thread

ROOT = Path(__file__).resolve().parent.parent

use_one_blas_thread()  # NumPy is not loaded yet: trackers here are as a worker has them

# Machines differ in speed: no test fails for being slow. In CI the same examples every time.
settings.register_profile("local", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "local")

# The disk holds some thousand data directories at once: none keeps room to delete with, unless a test is about that.
os.environ.setdefault("SKYPOSE_DISK_RESERVE_MB", "0")

# astropy, which tests compare with, is not to go to the network, and the data it has will do however old they get.
# deploy/gpu-check goes without it.
if find_spec("astropy"):
    from astropy.utils import iers

    iers.conf.auto_download = False
    iers.conf.auto_max_age = None


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    """Tests marked ``anyio`` run on asyncio, as the service does."""
    return "asyncio"


@pytest.fixture(scope="session")
def root() -> Path:
    """The checkout."""
    return ROOT


@pytest.fixture(scope="session")
def shared() -> Path:
    """Data for tests kept beside the checkout: skips the test where there is none."""
    folder = ROOT.parent / "shared"
    if not folder.is_dir():
        pytest.skip("no ../shared beside the checkout")
    return folder


@pytest.fixture(scope="session")
def postgres() -> Iterator[Postgres]:
    """A PostgreSQL server of its own, for all tests; skips where there is none to start."""
    server = Postgres()
    yield server
    server.close()
