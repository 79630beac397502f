"""The uploaded models: prepared once, known by their content."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import orjson
from pydantic import TypeAdapter

from service.inference.articulation import Articulation, Joint, Stage
from service.inference.symmetry import Symmetry
from service.sessions.frame import format_time
from service.store import models
from service.store.base import NO_QUOTAS, ModelRecord, Page, Quotas
from service.store.database import Database
from service.store.scope import ModelKey, model_key, public_id
from service.workers.base import MeshJob, ModelJob, ModelReport
from service.workers.engine import Engine
from service.workers.model_files import pack_model

ARTICULATION: TypeAdapter[Articulation] = TypeAdapter(Articulation)
TWINS: TypeAdapter[tuple[Symmetry, ...]] = TypeAdapter(tuple[Symmetry, ...])
Document = dict[str, Any]


@dataclass(frozen=True)
class Upload:
    """A model file as it was sent."""

    data: bytes
    file_type: str
    name: str
    joints: tuple[Mapping[str, Any], ...] | None

    @classmethod
    def packed(
        cls,
        data: bytes,
        file_type: str,
        name: str,
        joints: tuple[Mapping[str, Any], ...] | None,
        meshes: Mapping[str, bytes],
    ) -> Upload:
        """With the mesh files that a URDF file names. Raises ``InputError`` for those of another format."""
        return cls(pack_model(data, file_type, meshes), file_type, name, joints)


def articulation_of(model: ModelRecord) -> Articulation:
    """Parts and joints of a stored model."""
    return ARTICULATION.validate_python(model.report["articulation"])


def twins_of(model: ModelRecord) -> tuple[Symmetry, ...]:
    """Symmetries of a stored model; none of one that was stored before they were looked for."""
    return TWINS.validate_python(model.report.get("twins", ()))


class Library:
    """Takes models in and describes them."""

    def __init__(self, database: Database, engine: Engine, quotas: Quotas = NO_QUOTAS) -> None:
        self._database = database
        self._quotas = quotas
        self._engine = engine

    async def add(self, tenant: str, upload: Upload) -> tuple[Document, bool]:
        """Prepare and store a model, unless the same content is there. Returns it, and whether it is new.

        Raises what the worker finds wrong with it: ``MeshFileError``, ``JointError``, ``TooLargeError``.
        """
        key = model_key(tenant, await asyncio.to_thread(content_id, upload))
        known = await self._database.read(models.find, key)
        if known is not None:
            return model_document(known), False
        record = await self.prepare(tenant, key, upload)
        await self._database.write(models.add, record, upload.data, self._quotas)
        return model_document(record), True

    async def prepare(self, tenant: str, key: ModelKey, upload: Upload) -> ModelRecord:
        """Check and describe a model, without storing it."""
        report = await self._engine.prepare_model(tenant, ModelJob(upload.data, upload.file_type, upload.joints))
        blob_key = (await asyncio.to_thread(hashlib.sha256, upload.data)).hexdigest()
        return ModelRecord(
            id=key,
            tenant=tenant,
            name=upload.name,
            file_type=upload.file_type,
            blob_key=blob_key,
            joints=upload.joints,
            report=_report(report),
            created_at=format_time(datetime.now(UTC)),
        )

    async def get(self, model_id: ModelKey) -> Document:
        """One model. Raises ``NotFoundError``."""
        return model_document(await self._database.read(models.get, model_id))

    async def mesh(self, model_id: ModelKey) -> bytes:
        """GLB of a model as it was prepared. Raises ``NotFoundError``."""
        record = await self._database.read(models.get, model_id)
        return await self._engine.mesh(record.tenant, MeshJob(record.blob_key, record.file_type), self._blob)

    async def page(self, tenant: str, after: int, limit: int) -> Page[bytes]:
        """A tenant's models after a cursor as JSON."""
        found = await self._database.read(models.page, tenant, after, limit)
        return Page(await asyncio.to_thread(_jsons, found.records), found.damaged, found.cursor)

    async def remove(self, model_id: ModelKey) -> None:
        """Delete a model. Raises ``NotFoundError``, or ``ModelInUseError`` while a session needs it."""
        await self._database.free(models.remove, model_id)

    async def _blob(self, key: str) -> bytes:
        return await self._database.read(models.get_blob, key)


def _jsons(records: Sequence[ModelRecord]) -> tuple[bytes, ...]:
    return tuple(orjson.dumps(model_document(record)) for record in records)


def content_id(upload: Upload) -> str:
    """Hash of the file and the joints given with it."""
    digest = hashlib.sha256(upload.data)
    if upload.joints is not None:
        digest.update(b"\0joints\0" + orjson.dumps(upload.joints, option=orjson.OPT_SORT_KEYS))
    digest.update(b"\0" + upload.file_type.encode())
    return digest.hexdigest()[:32]


def model_document(record: ModelRecord) -> Document:
    """A stored model as the API answers it."""
    report = record.report
    articulation = articulation_of(record)
    return {
        "model_id": public_id(record.id),
        "name": record.name,
        "file_type": record.file_type,
        **{name: report[name] for name in ("faces", "vertices", "size", "centre", "watertight")},
        "parts": list(articulation.parts),
        "joints": [_joint(joint, report["centre"]) for joint in articulation.joints],
        "symmetries": report["symmetries"],
        "warnings": report["warnings"],
        "created_at": record.created_at,
    }


def _report(report: ModelReport) -> Document:
    return {
        "faces": report.faces,
        "vertices": report.vertices,
        "size": list(report.size),
        "centre": list(report.centre),
        "watertight": report.watertight,
        "articulation": ARTICULATION.dump_python(report.articulation, mode="json"),
        "symmetries": [dict(item) for item in report.symmetries],
        "warnings": list(report.warnings),
        "twins": TWINS.dump_python(report.twins, mode="json"),
    }


def _joint(joint: Joint, centre: list[float]) -> Document:
    stages = [_stage(stage, centre) for stage in joint.stages]
    return {
        **stages[0],
        "name": joint.name,
        "min": joint.minimum,
        "max": joint.maximum,
        "initial": joint.initial,
        "period": joint.period,
        "stages": stages,
    }


def _stage(stage: Stage, centre: list[float]) -> Document:
    origin = [a + b for a, b in zip(stage.origin, centre, strict=True)]  # body frame -> file coordinates
    return {
        "kind": stage.kind,
        "parts": list(stage.parts),
        "axis": list(stage.axis),
        "origin": origin,
        "depth": stage.depth,
        "ratio": stage.ratio,
    }
