"""On a disk that is full to the last byte sessions can be deleted, and their room is used again."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent / "full_disk.py"


def test_deleting_works_on_a_full_disk(tmp_path):
    own_disk = f"mount -t tmpfs -o size=40m none {tmp_path}"
    alone = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-ec"]
    if subprocess.run([*alone, own_disk], capture_output=True, check=False).returncode != 0:
        pytest.skip("no disk of its own can be mounted here")
    command = f"{own_disk}; exec {sys.executable} {SCRIPT} {tmp_path}"
    ended = subprocess.run([*alone, command], capture_output=True, text=True, check=False, timeout=120)
    assert ended.returncode == 0, ended.stderr
