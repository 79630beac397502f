"""Python client of the service, sync (``Client``) and async (``AsyncClient``), with the same calls.

    with Client("http://127.0.0.1:8000") as client:
        model = client.upload_model(Path("satellite.glb"))
        session = client.create_session(model.model_id)
        client.add_background(session.session_id, Path("sky.png"))
        estimate = client.put_frame(session.session_id, 0, Path("frame_000.png"))

Answers are the documents of the API (``service.api.schemas``). A call is repeated when the connection breaks or the
service is busy; every frame carries an index or a key, so it is tracked exactly once. docs/client.md tells more.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar, Unpack

import httpx

from service.api import schemas
from service.api.motion import PassMotion
from service.api.object_schemas import ObjectMotion, ObjectSpin, TrackedObject
from service.remote import calls
from service.remote.async_client import AsyncClient
from service.remote.calls import Arrays, Call, Image
from service.remote.connection import Connection
from service.remote.errors import ClientError, RefusedError, UnexpectedError
from service.remote.events import Cursor, Event
from service.remote.media import frames_in
from service.remote.options import FrameFacts, Region, Sections, StreamKind, http_options
from service.remote.retries import Retries

__all__ = [
    "AsyncClient",
    "Client",
    "ClientError",
    "Event",
    "FrameFacts",
    "RefusedError",
    "Retries",
    "UnexpectedError",
    "frames_in",
]
T = TypeVar("T")


class Client:
    """Calls of the API. One instance may serve several threads; close it, or use it as a context manager."""

    def __init__(
        self,
        url: str,
        *,
        api_key: str | None = None,
        timeout_s: float = 120.0,
        stale_s: float = 60.0,
        retries: Retries | None = None,
        transport: httpx.BaseTransport | None = None,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """``timeout_s`` bounds each wait of a call, ``stale_s`` the silence of a stream before it is opened anew."""
        http = httpx.Client(transport=transport, **http_options(url, api_key, timeout_s))
        self._connection = Connection(http, retries or Retries(), stale_s, sleep)

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let the connections go."""
        self._connection.close()

    def call(self, call: Call[T]) -> T:
        """Send a call, as often as its kind and ``Retries`` allow. Raises ``ClientError``, ``httpx.TransportError``."""
        return self._connection.call(call)

    def upload_model(
        self,
        file: Image,
        *,
        name: str | None = None,
        file_name: str | None = None,
        joints: Sequence[Mapping[str, Any]] | None = None,
        meshes: Sequence[Path] | None = None,
    ) -> schemas.Model:
        """Upload a mesh file; the same content again is the same model.

        ``meshes``: the files that a URDF file names; those that lie near it are found where none are given.
        """
        return self.call(calls.upload_model(file, name, file_name, joints, meshes))

    def model(self, model_id: str) -> schemas.Model:
        """One model."""
        return self.call(calls.get(schemas.Model, f"/v1/models/{model_id}"))

    def models(self) -> Iterator[schemas.Model]:
        """All models, in order of upload."""
        for page in self._connection.pages(schemas.ModelList, "/v1/models", {}):
            yield from page.models

    def delete_model(self, model_id: str) -> None:
        """Delete a model that no session needs."""
        self.call(calls.delete(f"/v1/models/{model_id}"))

    def create_session(
        self,
        model_id: str | None = None,
        *,
        model_ids: Sequence[str] | None = None,
        name: str | None = None,
        **sections: Unpack[Sections],
    ) -> schemas.Session:
        """Begin a session. ``sections``: filter, likelihood, prior, motion, camera, joints, light: dictionaries."""
        return self.call(calls.create_session({"model_id": model_id, "model_ids": model_ids, "name": name, **sections}))

    def session(self, session_id: str) -> schemas.Session:
        """One session."""
        return self.call(calls.get(schemas.Session, f"/v1/sessions/{session_id}"))

    def sessions(self) -> Iterator[schemas.Session]:
        """All sessions, in order of creation."""
        for page in self._connection.pages(schemas.SessionList, "/v1/sessions", {}):
            yield from page.sessions

    def delete_session(self, session_id: str) -> None:
        """Delete a session with its history."""
        self.call(calls.delete(f"/v1/sessions/{session_id}"))

    def add_background(
        self, session_id: str, image: Image, media_type: str | None = None, **region: Unpack[Region]
    ) -> schemas.BackgroundResult:
        """Teach the session empty sky; ``box`` or ``border`` where the object is in the image."""
        return self.call(calls.add_background(session_id, image, media_type, region))

    def post_frame(
        self,
        session_id: str,
        image: Image,
        media_type: str | None = None,
        *,
        key: str | None = None,
        **facts: Unpack[FrameFacts],
    ) -> schemas.Estimate:
        """Track the next frame. ``key`` is its Idempotency-Key, drawn at random where none is given."""
        return self.call(calls.frame(session_id, image, media_type, None, key, facts))

    def put_frame(
        self, session_id: str, index: int, image: Image, media_type: str | None = None, **facts: Unpack[FrameFacts]
    ) -> schemas.Estimate:
        """Track frame ``index``, exactly once: also across restarts of this program."""
        return self.call(calls.frame(session_id, image, media_type, index, None, facts))

    def track(
        self, mesh: Path | str, frames: Path | str, *, name: str | None = None, **sections: Unpack[Sections]
    ) -> Iterator[schemas.Estimate]:
        """A pass in one call: a new session of ``mesh``, and every image and video of a folder, by name.

        Estimates come as they are made, and name the session. The sky is learned from the frames. Raises
        ``FileNotFoundError`` for a folder without images.
        """
        images = frames_in(Path(frames))
        sections.setdefault("background", "auto")
        session = self.create_session(self.upload_model(Path(mesh)).model_id, name=name, **sections)
        for path in images:
            yield from self.track_file(session.session_id, path)

    def track_file(
        self,
        session_id: str,
        file: Image,
        media_type: str | None = None,
        *,
        index: int | None = None,
        key: str | None = None,
        **facts: Unpack[FrameFacts],
    ) -> Iterator[schemas.Estimate]:
        """Every frame of a file (FITS cube, SER, video, ...): estimates as they come.

        When the connection breaks the file is sent again; frames that were tracked are not tracked twice.
        """
        return self._connection.track(calls.frame(session_id, file, media_type, index, key, facts))

    def frame_by_key(self, session_id: str, key: str) -> schemas.Estimate | None:
        """The estimate of the frame that was posted with this key; None where there is none (yet)."""
        return self.call(calls.frame_by_key(session_id, key))

    def estimate(self, session_id: str, index: int | None = None) -> schemas.Estimate:
        """The estimate of one frame, the newest by default."""
        return self.call(
            calls.get(schemas.Estimate, f"/v1/sessions/{session_id}/estimates/{'latest' if index is None else index}")
        )

    def estimates(self, session_id: str, *, after: int = -1, smoothed: bool = False) -> Iterator[schemas.Estimate]:
        """Estimates after a frame, page by page; ``smoothed``: with all later frames taken into account."""
        path = f"/v1/sessions/{session_id}/estimates"
        for page in self._connection.pages(schemas.EstimateList, path, {"after": after, "smoothed": smoothed or None}):
            yield from page.estimates

    def motion(self, session_id: str) -> PassMotion:
        """How the object turned, from all frames. Raises ``ClientError`` (409) for too few of them."""
        return self.call(calls.get(PassMotion, f"/v1/sessions/{session_id}/motion"))

    def create_object(self, name: str, sessions: Sequence[str] = ()) -> TrackedObject:
        """Name what several sessions are of: those of several telescopes, of several passes."""
        return self.call(calls.create_object(name, sessions))

    def join_object(self, object_id: str, session_id: str) -> TrackedObject:
        """A session is of this object."""
        return self.call(calls.join_object(object_id, session_id))

    def object_motion(self, object_id: str, number: int | None = None) -> ObjectMotion:
        """How an object turned in a pass (the last by default), by all telescopes that saw it."""
        return self.call(calls.object_motion(object_id, number))

    def object_spin(self, object_id: str) -> ObjectSpin:
        """Rate, period, axis and their trend over all passes of an object."""
        return self.call(calls.get(ObjectSpin, f"/v1/objects/{object_id}/spin"))

    def object_report(self, object_id: str) -> bytes:
        """The object for people, as one HTML file. Raises ``ClientError`` (409) before the first frame."""
        return self.call(calls.get_bytes(f"/v1/objects/{object_id}/report"))

    def report(self, session_id: str) -> bytes:
        """The pass for people, as one HTML file. Raises ``ClientError`` (409) before the first frame."""
        return self.call(calls.get_bytes(f"/v1/sessions/{session_id}/report"))

    def overlay(self, session_id: str, index: int) -> bytes:
        """PNG of a frame with the best silhouette in blue."""
        return self.call(calls.get_bytes(f"/v1/sessions/{session_id}/estimates/{index}/overlay.png"))

    def frame_fits(self, session_id: str, index: int) -> bytes:
        """A frame as FITS with its pose in ``POSE_*`` cards."""
        return self.call(calls.get_bytes(f"/v1/sessions/{session_id}/estimates/{index}/frame.fits"))

    def particles(self, session_id: str, index: int | None = None) -> Arrays:
        """The weighted particles after a frame, the newest by default."""
        return self.call(calls.get_particles(session_id, index))

    def export(
        self, session_id: str, file_format: str = "csv", *, smoothed: bool | None = None, **options: str
    ) -> bytes:
        """The attitude history as ``aem``, ``acm``, ``apm``, ``stk``, ``czml``, ``csv``, ``npz`` (docs/formats.md)."""
        return self.call(calls.export(session_id, file_format, smoothed, options))

    def checkpoint(self, session_id: str) -> bytes:
        """The whole session as a portable blob."""
        return self.call(calls.get_bytes(f"/v1/sessions/{session_id}/checkpoint"))

    def put_checkpoint(self, session_id: str, blob: bytes) -> schemas.Session:
        """Take a session in from another service."""
        return self.call(calls.put_checkpoint(session_id, blob))

    def system(self) -> schemas.System:
        """What the service runs on."""
        return self.call(calls.get(schemas.System, "/v1/system"))

    def watch(
        self, session_id: str, *, after: int | None = None, over: StreamKind = "websocket", heartbeats: bool = False
    ) -> Iterator[Event]:
        """The session's events after number ``after`` (0: all; None: from now on), until the session is deleted.

        A stream that breaks or falls silent is opened again where it stood: no event is lost or told twice.
        """
        start = self.session(session_id).last_seq if after is None else after
        return self._connection.watch(session_id, Cursor(start, heartbeats=heartbeats), over)
