"""Posting a folder's files to a session, each exactly once, whatever is interrupted."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path

from service.api.schemas import Estimate
from service.client import Client, RefusedError
from service.errors import SkyposeError
from service.imaging.split import frame_count
from service.remote.media import media_type_of
from service.remote.options import FrameFacts

_BAD_FILE = (413, 415, 422)


class FilePoster:
    """Knows nothing of its own: what was posted, the service remembers by the key that name and content make."""

    def __init__(self, client: Client, session_id: str, *, file_times: bool) -> None:
        self._client = client
        self._session_id = session_id
        self._file_times = file_times

    def post(self, path: Path, refused: Callable[[Path, RefusedError], None]) -> Iterator[Estimate]:
        """Estimates of a file's frames; none if it was posted before.

        A file that cannot be read as an image is told to ``refused`` and left. Raises ``ClientError`` for the rest.
        """
        body, kind = path.read_bytes(), media_type_of(path.name)
        assert kind is not None, "only files with a media type are watched"
        key = file_key(path.name, body)
        if self._known(key, body, kind):
            return
        facts: FrameFacts = {}
        if self._file_times:
            facts["time"] = datetime.fromtimestamp(path.stat().st_mtime, UTC)
        try:
            yield from self._client.track_file(self._session_id, body, kind, key=key, **facts)
        except RefusedError as error:
            if error.status not in _BAD_FILE:
                raise
            refused(path, error)

    def _known(self, key: str, body: bytes, kind: str) -> bool:
        """Whether the last of the file's frames was tracked. A video has to be posted to know: nothing is repeated."""
        try:
            frames = frame_count(body, kind)
        except SkyposeError:
            return False  # the service says what is wrong with it
        if frames is None or frames < 1:
            return False
        last = key if frames == 1 else f"{key}#{frames - 1}"
        return self._client.frame_by_key(self._session_id, last) is not None


def file_key(name: str, body: bytes) -> str:
    """Idempotency-Key of a file: the same name and content are the same frame, anything else is another."""
    content = hashlib.sha256(body).hexdigest()
    return "ingest-" + hashlib.sha256(f"{name}\0{content}".encode()).hexdigest()[:40]
