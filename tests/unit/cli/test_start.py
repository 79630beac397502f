"""What a start of the service loads: after a kill, every import is time that clients wait."""

import os
import subprocess
import sys

WEB_NEEDS_NONE = (
    "scipy",
    "trimesh",
    "collada",
    "PIL",
    "jwt",
    "cryptography",
    "astropy",
    "alembic",
    "pyopencl",
    "moderngl",
    "psycopg",
    "jinja2",
    "httpx",
)


WORKER_NEEDS_NONE = (
    "trimesh",
    "collada",
    "PIL",
    "astropy",
    "fastapi",
    "sqlalchemy",
    "pydantic",
    "scipy.stats",
    "structlog",
)


def loaded_by(module: str) -> set[str]:
    code = f"import sys, {module}; print(*sys.modules)"
    return set(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split())


def test_the_web_process_loads_none_of_the_large_libraries_of_others():
    """They are the workers', or those of a database or an identity provider that is not there."""
    assert sorted(set(WEB_NEEDS_NONE) & loaded_by("service.main")) == []


def test_a_worker_loads_no_mesh_library_and_no_statistics():
    """Files are its decode process's; each of these takes a third of a second and tens of megabytes."""
    assert sorted(set(WORKER_NEEDS_NONE) & loaded_by("service.workers.guarded")) == []


def test_a_command_computes_with_one_thread_of_blas_as_a_worker_does():
    code = "from service import cli; cli.app = lambda: None; cli.main(); "
    code += "import os, numpy; numpy.linalg.inv(numpy.eye(400)); "
    code += "print(os.environ['OPENBLAS_NUM_THREADS'], len(os.listdir('/proc/self/task')))"
    env = {name: value for name, value in os.environ.items() if "NUM_THREADS" not in name}
    told = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, env=env).stdout
    assert told.split() == ["1", "1"]
