"""What a start of the service loads: after a kill, every import is time that clients wait."""

import subprocess
import sys

HEAVY = (
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
)


def test_the_web_process_loads_none_of_the_large_libraries_of_others():
    """They are the workers', or those of a database or an identity provider that is not there."""
    code = "import sys, service.main; print(*{name.partition('.')[0] for name in sys.modules})"
    loaded = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split()
    assert sorted(set(HEAVY) & set(loaded)) == []
