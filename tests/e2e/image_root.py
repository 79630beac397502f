"""A built image's file system as a container with a read-only root has it, without a container runtime.

As ``docker run --read-only --tmpfs /tmp`` would: the root is mounted read-only in a mount namespace of its own, the
volumes that the image declares and /tmp are empty file systems, and the command runs as the image's user.
"""

import json
import os
import random
import signal
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

STORAGE = {**os.environ, "BUILDAH_ISOLATION": "chroot", "STORAGE_DRIVER": "vfs"}
_ENTER = """
set -e
root=$1 user=$2 volumes=$3
shift 3
mount --bind "$root" "$root"
mount -t proc proc "$root/proc"
mount --rbind /dev "$root/dev"
mount --rbind /sys "$root/sys"
mount -t tmpfs -o mode=1777 tmpfs "$root/tmp"
for volume in $volumes; do mount -t tmpfs -o "uid=$user,gid=$user,mode=0700" tmpfs "$root$volume"; done
mount -o remount,bind,ro "$root"
cd "$root"
exec chroot --userspec="$user:$user" . env -i "$@"
"""


def buildah(*arguments: str) -> str:
    """Run buildah; its output. Raises ``CalledProcessError``."""
    return subprocess.run(
        ["buildah", *arguments], env=STORAGE, check=True, capture_output=True, text=True, timeout=300
    ).stdout


def lasting_port() -> int:
    """A free port below those that the system gives to outgoing connections: nobody gets it before the service does."""
    for port in random.sample(range(20_000, 30_000), 100):
        with socket.socket() as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    raise OSError("no port is free")


def can_mount() -> bool:
    """Whether this process may make a mount namespace; many containers forbid it."""
    tried = subprocess.run(["unshare", "--mount", "mount", "-t", "tmpfs", "tmpfs", "/mnt"], capture_output=True)
    return tried.returncode == 0


@dataclass(frozen=True)
class ImageRoot:
    """An image's files, mounted somewhere, and how the image wants to be run."""

    path: Path
    config: dict[str, Any]  # of the image: Env, Volumes, User, Cmd
    uid: int

    def command(self, *words: str) -> list[str]:
        """The command that runs ``words`` in the read-only root."""
        volumes = " ".join(sorted(self.config["Volumes"]))
        enter = ["unshare", "--mount", "bash", "-c", _ENTER, "enter", str(self.path), str(self.uid), volumes]
        return [*enter, *self.config["Env"], *words]

    def run(self, *words: str) -> "subprocess.CompletedProcess[str]":
        """Run to its end."""
        return subprocess.run(self.command(*words), capture_output=True, text=True, timeout=120)


@contextmanager
def mounted(image: str) -> Iterator[ImageRoot]:
    """The image's files. What is written there is not written to the image."""
    container = buildah("from", "--pull-never", f"localhost/{image}").strip()
    try:
        path = Path(buildah("mount", container).strip())
        config = json.loads(buildah("inspect", "--type", "image", f"localhost/{image}"))["OCIv1"]["config"]
        users = dict(line.split(":")[0:3:2] for line in (path / "etc" / "passwd").read_text().splitlines())
        yield ImageRoot(path, config, int(users[config["User"]]))
    finally:
        buildah("rm", container)


@contextmanager
def running(command: list[str], log: Path) -> Iterator["subprocess.Popen[bytes]"]:
    """A process in a session of its own, ended with all that it started."""
    with log.open("wb") as sink:
        process = subprocess.Popen(command, stdout=sink, stderr=subprocess.STDOUT, start_new_session=True)
    try:
        yield process
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGTERM)
            process.wait(120)
