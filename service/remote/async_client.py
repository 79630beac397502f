"""The async client: ``service.client.Client`` with ``await`` and ``async for``."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping, Sequence
from contextlib import aclosing
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar, Unpack

import httpx

from service.api import schemas
from service.api.motion import PassMotion
from service.api.object_schemas import ObjectMotion, ObjectSpin, TrackedObject
from service.remote import calls
from service.remote.aio import AsyncConnection
from service.remote.calls import Arrays, Call, Image
from service.remote.events import Cursor, Event
from service.remote.media import frames_in
from service.remote.options import FrameFacts, Region, Sections, StreamKind, http_options
from service.remote.retries import Retries

T = TypeVar("T")


class AsyncClient:
    """Calls of the API. Close it, or use it as a context manager."""

    def __init__(
        self,
        url: str,
        *,
        api_key: str | None = None,
        timeout_s: float = 120.0,
        stale_s: float = 60.0,
        retries: Retries | None = None,
        transport: httpx.AsyncBaseTransport | None = None,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        """``timeout_s`` bounds each wait of a call, ``stale_s`` the silence of a stream before it is opened anew."""
        http = httpx.AsyncClient(transport=transport, **http_options(url, api_key, timeout_s))
        self._connection = AsyncConnection(http, retries or Retries(), stale_s, sleep)

    async def __aenter__(self) -> AsyncClient:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.aclose()

    async def aclose(self) -> None:
        """Let the connections go."""
        await self._connection.aclose()

    async def call(self, call: Call[T]) -> T:
        """Send a call, as often as its kind and ``Retries`` allow. Raises ``ClientError``, ``httpx.TransportError``."""
        return await self._connection.call(call)

    async def upload_model(
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
        return await self.call(await asyncio.to_thread(calls.upload_model, file, name, file_name, joints, meshes))

    async def model(self, model_id: str) -> schemas.Model:
        """One model."""
        return await self.call(calls.get(schemas.Model, f"/v1/models/{model_id}"))

    async def models(self) -> AsyncGenerator[schemas.Model]:
        """All models, in order of upload."""
        async for page in self._connection.pages(schemas.ModelList, "/v1/models", {}):
            for item in page.models:
                yield item

    async def delete_model(self, model_id: str) -> None:
        """Delete a model that no session needs."""
        await self.call(calls.delete(f"/v1/models/{model_id}"))

    async def create_session(
        self,
        model_id: str | None = None,
        *,
        model_ids: Sequence[str] | None = None,
        name: str | None = None,
        **sections: Unpack[Sections],
    ) -> schemas.Session:
        """Begin a session. ``sections``: filter, likelihood, prior, motion, camera, joints, each a dictionary."""
        return await self.call(
            calls.create_session({"model_id": model_id, "model_ids": model_ids, "name": name, **sections})
        )

    async def session(self, session_id: str) -> schemas.Session:
        """One session."""
        return await self.call(calls.get(schemas.Session, f"/v1/sessions/{session_id}"))

    async def sessions(self) -> AsyncGenerator[schemas.Session]:
        """All sessions, in order of creation."""
        async for page in self._connection.pages(schemas.SessionList, "/v1/sessions", {}):
            for item in page.sessions:
                yield item

    async def delete_session(self, session_id: str) -> None:
        """Delete a session with its history."""
        await self.call(calls.delete(f"/v1/sessions/{session_id}"))

    async def add_background(
        self, session_id: str, image: Image, media_type: str | None = None, **region: Unpack[Region]
    ) -> schemas.BackgroundResult:
        """Teach the session empty sky; ``box`` or ``border`` where the object is in the image."""
        return await self.call(await asyncio.to_thread(calls.add_background, session_id, image, media_type, region))

    async def post_frame(
        self,
        session_id: str,
        image: Image,
        media_type: str | None = None,
        *,
        key: str | None = None,
        **facts: Unpack[FrameFacts],
    ) -> schemas.Estimate:
        """Track the next frame. ``key`` is its Idempotency-Key, drawn at random where none is given."""
        return await self.call(await asyncio.to_thread(calls.frame, session_id, image, media_type, None, key, facts))

    async def put_frame(
        self, session_id: str, index: int, image: Image, media_type: str | None = None, **facts: Unpack[FrameFacts]
    ) -> schemas.Estimate:
        """Track frame ``index``, exactly once: also across restarts of this program."""
        return await self.call(await asyncio.to_thread(calls.frame, session_id, image, media_type, index, None, facts))

    async def track(
        self, mesh: Path | str, frames: Path | str, *, name: str | None = None, **sections: Unpack[Sections]
    ) -> AsyncGenerator[schemas.Estimate]:
        """A pass in one call: a new session of ``mesh``, and every image and video of a folder, by name.

        Estimates come as they are made, and name the session. The sky is learned from the frames. Raises
        ``FileNotFoundError`` for a folder without images.
        """
        images = await asyncio.to_thread(frames_in, Path(frames))
        sections.setdefault("background", "auto")
        session = await self.create_session((await self.upload_model(Path(mesh))).model_id, name=name, **sections)
        for path in images:
            async with aclosing(self.track_file(session.session_id, path)) as estimates:
                async for estimate in estimates:
                    yield estimate

    def track_file(
        self,
        session_id: str,
        file: Image,
        media_type: str | None = None,
        *,
        index: int | None = None,
        key: str | None = None,
        **facts: Unpack[FrameFacts],
    ) -> AsyncGenerator[schemas.Estimate]:
        """Every frame of a file (FITS cube, SER, video, ...): estimates as they come.

        When the connection breaks the file is sent again; frames that were tracked are not tracked twice.
        """
        return self._connection.track(calls.frame(session_id, file, media_type, index, key, facts))

    async def frame_by_key(self, session_id: str, key: str) -> schemas.Estimate | None:
        """The estimate of the frame that was posted with this key; None where there is none (yet)."""
        return await self.call(calls.frame_by_key(session_id, key))

    async def estimate(self, session_id: str, index: int | None = None) -> schemas.Estimate:
        """The estimate of one frame, the newest by default."""
        return await self.call(
            calls.get(schemas.Estimate, f"/v1/sessions/{session_id}/estimates/{'latest' if index is None else index}")
        )

    async def estimates(
        self, session_id: str, *, after: int = -1, smoothed: bool = False
    ) -> AsyncGenerator[schemas.Estimate]:
        """Estimates after a frame, page by page; ``smoothed``: with all later frames taken into account."""
        path = f"/v1/sessions/{session_id}/estimates"
        async for page in self._connection.pages(
            schemas.EstimateList, path, {"after": after, "smoothed": smoothed or None}
        ):
            for item in page.estimates:
                yield item

    async def motion(self, session_id: str) -> PassMotion:
        """How the object turned, from all frames. Raises ``ClientError`` (409) for too few of them."""
        return await self.call(calls.get(PassMotion, f"/v1/sessions/{session_id}/motion"))

    async def create_object(self, name: str, sessions: Sequence[str] = ()) -> TrackedObject:
        """Name what several sessions are of: those of several telescopes, of several passes."""
        return await self.call(calls.create_object(name, sessions))

    async def join_object(self, object_id: str, session_id: str) -> TrackedObject:
        """A session is of this object."""
        return await self.call(calls.join_object(object_id, session_id))

    async def object_motion(self, object_id: str, number: int | None = None) -> ObjectMotion:
        """How an object turned in a pass (the last by default), by all telescopes that saw it."""
        return await self.call(calls.object_motion(object_id, number))

    async def object_spin(self, object_id: str) -> ObjectSpin:
        """Rate, period, axis and their trend over all passes of an object."""
        return await self.call(calls.get(ObjectSpin, f"/v1/objects/{object_id}/spin"))

    async def object_report(self, object_id: str) -> bytes:
        """The object for people, as one HTML file. Raises ``ClientError`` (409) before the first frame."""
        return await self.call(calls.get_bytes(f"/v1/objects/{object_id}/report"))

    async def report(self, session_id: str) -> bytes:
        """The pass for people, as one HTML file. Raises ``ClientError`` (409) before the first frame."""
        return await self.call(calls.get_bytes(f"/v1/sessions/{session_id}/report"))

    async def overlay(self, session_id: str, index: int) -> bytes:
        """PNG of a frame with the best silhouette in blue."""
        return await self.call(calls.get_bytes(f"/v1/sessions/{session_id}/estimates/{index}/overlay.png"))

    async def frame_fits(self, session_id: str, index: int) -> bytes:
        """A frame as FITS with its pose in ``POSE_*`` cards."""
        return await self.call(calls.get_bytes(f"/v1/sessions/{session_id}/estimates/{index}/frame.fits"))

    async def particles(self, session_id: str, index: int | None = None) -> Arrays:
        """The weighted particles after a frame, the newest by default."""
        return await self.call(calls.get_particles(session_id, index))

    async def export(
        self, session_id: str, file_format: str = "csv", *, smoothed: bool | None = None, **options: str
    ) -> bytes:
        """The attitude history as ``aem``, ``acm``, ``apm``, ``stk``, ``czml``, ``csv``, ``npz`` (docs/formats.md)."""
        return await self.call(calls.export(session_id, file_format, smoothed, options))

    async def checkpoint(self, session_id: str) -> bytes:
        """The whole session as a portable blob."""
        return await self.call(calls.get_bytes(f"/v1/sessions/{session_id}/checkpoint"))

    async def put_checkpoint(self, session_id: str, blob: bytes) -> schemas.Session:
        """Take a session in from another service."""
        return await self.call(calls.put_checkpoint(session_id, blob))

    async def system(self) -> schemas.System:
        """What the service runs on."""
        return await self.call(calls.get(schemas.System, "/v1/system"))

    async def watch(
        self, session_id: str, *, after: int | None = None, over: StreamKind = "websocket", heartbeats: bool = False
    ) -> AsyncGenerator[Event]:
        """The session's events after number ``after`` (0: all; None: from now on), until the session is deleted.

        A stream that breaks or falls silent is opened again where it stood: no event is lost or told twice.
        """
        start = (await self.session(session_id)).last_seq if after is None else after
        async with aclosing(self._connection.watch(session_id, Cursor(start, heartbeats=heartbeats), over)) as events:
            async for event in events:
                yield event
