"""What was tracked, read back: sessions, estimates, overlays, particles. Reads only what is committed."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

import numpy as np
import orjson

from service.errors import NotFoundError
from service.exports.czml_model import ROOT
from service.exports.formats import Subject, export
from service.exports.history import Body, PoseName
from service.inference.articulation import hold
from service.inference.params import LightParams, SessionConfig
from service.sessions import config as session_config
from service.sessions.contenders import of_the_leader
from service.sessions.frame_fits import image_with_pose, is_fits, original_with_pose
from service.sessions.library import articulation_of
from service.sessions.lighting import sun_in_image
from service.sessions.particle_set import ParticleSet
from service.sessions.pass_motion import PassMotions
from service.sessions.smoothing import SmoothedPages
from service.store import frames, models, sessions
from service.store.base import ModelRecord, Page, SessionRecord
from service.store.database import Database
from service.store.scope import SessionKey, model_key, public_id, tenant_of
from service.workers.base import MeshJob, OverlayJob, Shown
from service.workers.engine import Engine
from service.workers.splitting import SplitJob

EVERYTHING = 1 << 30


class Archive:
    """The history of all sessions. Everything raises ``NotFoundError`` for what never was."""

    def __init__(self, database: Database, engine: Engine) -> None:
        self.database = database
        self._engine = engine
        self._smoothed = SmoothedPages(database, engine)
        self.motions = PassMotions(database, engine)

    async def session(self, session_id: SessionKey) -> dict[str, Any]:
        """One session."""
        return session_document(await self.database.read(sessions.get, session_id))

    async def sessions(self, tenant: str, after: int, limit: int) -> Page[bytes]:
        """A tenant's sessions after a cursor as JSON."""
        found = await self.database.read(sessions.page, tenant, after, limit)
        documents = tuple(orjson.dumps(session_document(record)) for record in found.records)
        return Page(documents, found.damaged, found.cursor)

    async def estimate(self, session_id: SessionKey, index: int | None) -> bytes:
        """The estimate of a frame (None: the newest) as JSON bytes."""
        return await self.database.read(frames.estimate, session_id, index)

    async def estimates(self, session_id: SessionKey, after: int, limit: int) -> tuple[list[bytes], int | None]:
        """Estimates after an index, and the index to go on from or None."""
        found = await self.database.read(frames.estimate_page, session_id, after, limit + 1)
        following = found[limit - 1][0] if len(found) > limit else None
        return [document for _, document in found[:limit]], following

    async def smoothed(self, session_id: SessionKey, after: int, limit: int) -> tuple[list[bytes], int | None]:
        """The same, each with all later frames taken into account."""
        return await self._smoothed.page(session_id, after, limit)

    async def motion(self, session_id: SessionKey) -> bytes:
        """How the object turned, as JSON. Raises ``ConflictError`` for too few frames."""
        return await self.motions.of(session_id)

    async def by_key(self, session_id: SessionKey, key: str) -> bytes | None:
        """The estimate of the frame that was sent with this idempotency key, or None."""
        _, stored = await self.database.read(frames.find, session_id, index=None, key=key)
        return None if stored is None else await self.estimate(session_id, stored.index)

    async def pictures(self, session_id: SessionKey, index: int, show: Sequence[Shown]) -> tuple[bytes, ...]:
        """PNGs of a frame, and of what its best pose says of it. Raises ``GoneError`` where it is no longer kept."""
        body, media_type = await self.database.read(frames.body, session_id, index)
        estimate = orjson.loads(await self.estimate(session_id, index))
        best = estimate["best"]
        record = await self.database.read(sessions.get, session_id)
        model, config = await self._setting(session_id, estimate)
        articulation = hold(articulation_of(model), config.joints.free, config.joints.fixed)
        job = OverlayJob(
            model=model.blob_key,
            file_type=model.file_type,
            articulation=articulation,
            body=body,
            media_type=media_type,
            quaternion=np.array([best["orientation"][axis] for axis in "wxyz"]),
            position=np.array([best["x_px"], best["y_px"]]),
            scale=best["scale_px"],
            joints=np.array([best["joints"][joint.name] for joint in articulation.joints], dtype=np.float64),
            config=config,
            background=record.background_key,
            sun=sun_in_image(estimate, config.camera),
            show=tuple(show),
        )
        return await self._engine.overlay(tenant_of(session_id), job, self._blob)

    async def frame_fits(self, session_id: SessionKey, index: int) -> bytes:
        """A frame as FITS with its pose. Raises ``GoneError`` where it is no longer kept."""
        body, media_type = await self.database.read(frames.body, session_id, index)
        estimate = await self.estimate(session_id, index)
        if is_fits(media_type):
            return await asyncio.to_thread(original_with_pose, body, estimate)
        _, config = await self._setting(session_id)
        job = SplitJob(body, media_type, config.camera.ser_byte_order)
        (frame,) = await self._engine.split(tenant_of(session_id), job)  # one frame: others are stored singly
        return await asyncio.to_thread(image_with_pose, frame.body, estimate)

    async def particles(self, session_id: SessionKey, index: int | None) -> ParticleSet:
        """The particles after a frame, the newest by default. Raises ``GoneError`` where they are not kept."""
        found, packed = await self.database.read(frames.particle_set, session_id, index)
        _, config = await self._setting(session_id)
        return ParticleSet(found, packed, tuple(await self.joint_units(session_id, found)), config.camera)

    async def joint_units(self, session_id: SessionKey, index: int | None = None) -> dict[str, str]:
        """Unit of each estimated joint by its name, in the order of their columns.

        ``index``: under the model of that frame.
        """
        estimate = None if index is None else orjson.loads(await self.estimate(session_id, index))
        model, config = await self._setting(session_id, estimate)
        held = hold(articulation_of(model), config.joints.free, config.joints.fixed)
        return {joint.name: "deg" if joint.kind == "revolute" else "units" for joint in held.joints}

    async def export(
        self,
        session_id: SessionKey,
        form: str,
        pose: PoseName,
        *,
        name: str | None,
        object_id: str,
        smoothed: bool | None,
        model: bool = False,
    ) -> bytes:
        """The history as a file; where models are compared, the frames in which the one that now leads did.

        ``smoothed`` None: only if the session has ended. ``model``: with the body itself, where the format can hold it.

        Raises ``ConflictError`` for an attitude format without any attitude.
        """
        record = await self.database.read(sessions.get, session_id)
        over = record.ended_at is not None if smoothed is None else smoothed
        read = self.smoothed if over else self.estimates
        found, _ = await read(session_id, -1, EVERYTHING)
        if record.model_ids:
            found = await asyncio.to_thread(of_the_leader, found)
        joints = await self.joint_units(session_id, record.next_index - 1 if found else None)
        called, orbit = name or record.name or public_id(session_id), record.config["prior"].get("orbit")
        newest = orjson.loads(found[-1]) if found else None
        body = await self._body(session_id, newest) if model and form == "czml" else None
        subject = Subject(called, object_id, joints, datetime.now(UTC), orbit, body)
        return await asyncio.to_thread(_export, form, found, pose, subject)

    async def _body(self, session_id: SessionKey, estimate: Mapping[str, Any] | None) -> Body:
        """What a viewer draws: the model of an estimate."""
        model, config = await self._setting(session_id, estimate)
        glb = await self._engine.mesh(
            tenant_of(session_id), MeshJob(model.blob_key, model.file_type, root=ROOT), self._blob
        )
        articulation = hold(articulation_of(model), config.joints.free, config.joints.fixed)
        return Body(glb, articulation, config.prior.unit_m or 1.0)

    async def require_key(self, session_id: SessionKey, key: str) -> None:
        """Say what is missing: the session, or a frame with this key."""
        await self.database.read(sessions.get, session_id)
        raise NotFoundError(f"no frame with key {key!r}", field="key")

    async def _setting(
        self, session_id: SessionKey, estimate: Mapping[str, Any] | None = None
    ) -> tuple[ModelRecord, SessionConfig]:
        """Model and configuration; where models are compared, the model that ``estimate`` was made with."""
        record = await self.database.read(sessions.get, session_id)
        ranked = None if estimate is None else estimate.get("models")
        key = model_key(record.tenant, ranked[0]["model_id"]) if ranked else record.model_id
        model = await self.database.read(models.get, key)
        return model, session_config.stored(record.config)

    async def _blob(self, key: str) -> bytes:
        return await self.database.read(models.get_blob, key)


def _export(form: str, documents: Sequence[bytes], pose: PoseName, subject: Subject) -> bytes:
    return export(form, [orjson.loads(document) for document in documents], pose, subject)


def session_document(record: SessionRecord) -> dict[str, Any]:
    """A stored session as the API answers it."""
    session_id, model_id = public_id(record.id), public_id(record.model_id)
    here = f"/v1/sessions/{session_id}"
    own_sky = record.config["camera"].get("background") == "auto"
    return {
        "session_id": session_id,
        "name": record.name,
        "model_id": None if record.model_ids else model_id,
        "model_ids": [public_id(key) for key in record.model_ids] or None,
        "state": "ready" if record.background_key is not None or own_sky else "waiting_for_background",
        "status": record.status,
        "frames": record.next_index,
        "last_seq": record.next_seq - 1,
        "background_frames": record.background_frames,
        "background": record.background_info,
        "created_at": record.created_at,
        "updated_at": record.updated_at,
        "ended_at": record.ended_at,
        "warnings": list(record.warnings),
        "light": asdict(LightParams()),  # of a session stored before there was a choice
        **record.config,
        "links": {
            **({} if record.model_ids else {"model": f"/v1/models/{model_id}"}),
            **{name: f"{here}/{name}" for name in ("background", "frames", "estimates", "particles")},
            **{name: f"{here}/{name}" for name in ("stream", "events", "checkpoint", "export", "motion", "report")},
        },
    }
