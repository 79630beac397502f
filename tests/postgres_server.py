"""A PostgreSQL server of the machine's own binaries, in a folder of its own, for as long as the tests run."""

import os
import pwd
import shutil
import socket
import subprocess
import tempfile
import uuid
from pathlib import Path

import pytest

USER = "skypose"
_FAST = ("fsync=off", "full_page_writes=off")


def binaries() -> Path | None:
    """The folder with ``initdb`` and ``pg_ctl`` of the newest version there is."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"), key=lambda path: float(path.parts[-3]))
    on_path = shutil.which("initdb")
    return found[-1].parent if found else (Path(on_path).resolve().parent if on_path else None)


class Postgres:
    """The server. ``durable``: with fsync, as in service."""

    def __init__(self, *, durable: bool = False) -> None:
        found = binaries()
        if found is None:
            pytest.skip("no PostgreSQL server here (Debian: apt-get install postgresql)")
        as_root = os.geteuid() == 0  # which initdb refuses
        if as_root and not any(user.pw_name == "postgres" for user in pwd.getpwall()):
            pytest.skip("root cannot start PostgreSQL, and there is no user postgres to do it")
        self._bin = found
        self._as: list[str] = []
        self.folder = Path(tempfile.mkdtemp(prefix="skypose-postgres-"))
        if as_root:
            shutil.chown(self.folder, "postgres", "postgres")
            self._as = ["runuser", "-u", "postgres", "--"]
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        data = self.folder / "data"
        self._run("initdb", "-D", str(data), "-U", USER, "--auth=trust", "--no-sync", "--encoding=UTF8", "--locale=C")
        lines = ["listen_addresses = '127.0.0.1'", f"port = {self.port}", f"unix_socket_directories = '{self.folder}'"]
        lines += ["max_connections = 100"] + ([] if durable else list(_FAST))
        self._as_user(["tee", "-a", str(data / "postgresql.conf")], input="\n".join([*lines, ""]))
        self.control("start")

    def control(self, *what: str) -> None:
        """``pg_ctl``, and wait until it is done."""
        data, log = str(self.folder / "data"), str(self.folder / "log")
        self._run("pg_ctl", "-D", data, "-l", log, "-w", "-s", *what)

    def database(self) -> str:
        """URL of a new, empty database."""
        name = f"t{uuid.uuid4().hex}"
        self.query("postgres", f"CREATE DATABASE {name}")
        return f"postgresql+psycopg://{USER}@127.0.0.1:{self.port}/{name}"

    def query(self, database: str, text: str) -> str:
        """What ``psql`` answers, plain."""
        where = ["-h", "127.0.0.1", "-p", str(self.port), "-U", USER, "-d", database]
        return self._run("psql", *where, "-v", "ON_ERROR_STOP=1", "-Atc", text).strip()

    def close(self) -> None:
        """Stop it and remove the folder."""
        self.control("stop", "-m", "immediate")
        shutil.rmtree(self.folder)

    def _run(self, program: str, *arguments: str) -> str:
        return self._as_user([str(self._bin / program), *arguments])

    def _as_user(self, command: list[str], **more: str) -> str:
        # Not a pipe for standard error: the server keeps it open.
        with (self.folder.parent / f"{self.folder.name}.err").open("w+") as errors:
            done = subprocess.run(
                [*self._as, *command], cwd="/", text=True, stdout=subprocess.PIPE, stderr=errors, check=False, **more
            )
            errors.seek(0)
            text = errors.read()
        Path(errors.name).unlink()
        if done.returncode:
            raise RuntimeError(f"{command[0]}: {text}")
        return done.stdout
