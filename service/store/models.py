"""Queries on models and blobs. Each takes the connection of a running transaction."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sqlalchemy import Connection, Row, delete, func, insert, or_, select

from service.errors import ModelInUseError, NotFoundError, QuotaExceededError
from service.store.base import NO_QUOTAS, ModelRecord, Page, Quotas
from service.store.pages import page_of
from service.store.scope import ModelKey, public_id
from service.store.seal import checked, record_values, row_of, sealed
from service.store.signals import alone
from service.store.tables import blobs, contenders, models, sessions


def add(connection: Connection, record: ModelRecord, data: bytes, quotas: Quotas = NO_QUOTAS) -> None:
    """Store a model and its file, unless the same is there. Raises ``QuotaExceededError``."""
    alone(connection)
    if find(connection, record.id) is None:
        count = connection.execute(select(func.count()).where(models.c.tenant == record.tenant)).scalar_one()
        if quotas.models and count >= quotas.models:
            raise QuotaExceededError(f"{count} models are there", limit=quotas.models, setting="SKYPOSE_QUOTA_MODELS")
        put_blob(connection, record.blob_key, data)
        values = {**row_of(models, record), "joints": _list(record.joints)}
        connection.execute(insert(models), sealed(models, values))


def find(connection: Connection, model_id: ModelKey) -> ModelRecord | None:
    """The model, or None."""
    row = connection.execute(select(models).where(models.c.id == model_id)).first()
    return None if row is None else _record(row)


def get(connection: Connection, model_id: ModelKey) -> ModelRecord:
    """The model. Raises ``NotFoundError``."""
    record = find(connection, model_id)
    if record is None:
        raise NotFoundError(f"no model {public_id(model_id)}", field="model_id")
    return record


def page(connection: Connection, tenant: str, after: int, limit: int) -> Page[ModelRecord]:
    """A tenant's models in order of creation, from number ``after`` on."""
    return page_of(connection, models, get, tenant, after, limit)


def remove(connection: Connection, model_id: ModelKey) -> None:
    """Delete a model and its file. Raises ``ModelInUseError`` while a session needs it."""
    alone(connection)
    record = get(connection, model_id)
    named = select(sessions.c.id).where(sessions.c.model_id == model_id)
    compared = select(contenders.c.session_id.label("id")).where(contenders.c.model_id == model_id)
    users = connection.execute(named.union(compared).limit(5)).all()
    if users:
        raise ModelInUseError(
            f"sessions need model {public_id(model_id)}", sessions=[public_id(row.id) for row in users]
        )
    connection.execute(delete(models).where(models.c.id == model_id))
    drop_blob_if_unused(connection, record.blob_key)


def put_blob(connection: Connection, key: str, data: bytes) -> None:
    """Store bytes under their content's key, unless they are there. For transactions that are ``alone``."""
    if connection.execute(select(blobs.c.key).where(blobs.c.key == key)).first() is None:
        connection.execute(insert(blobs), sealed(blobs, {"key": key, "data": data}))


def get_blob(connection: Connection, key: str) -> bytes:
    """The bytes under a key. Raises ``NotFoundError``."""
    row = connection.execute(select(blobs).where(blobs.c.key == key)).first()
    if row is None:
        raise NotFoundError(f"no blob {key}")
    data: bytes = checked(blobs, row).data
    return data


def drop_blob_if_unused(connection: Connection, key: str | None) -> None:
    """Delete a blob that no model and no session names. For transactions that are ``alone``."""
    if key is None:
        return
    used = or_(
        select(models.c.id).where(models.c.blob_key == key).exists(),
        select(sessions.c.id).where(sessions.c.background_key == key).exists(),
    )
    connection.execute(delete(blobs).where(blobs.c.key == key, ~used))


def _record(row: Row[Any]) -> ModelRecord:
    values = record_values(checked(models, row))
    joints = values["joints"]
    return ModelRecord(**{**values, "joints": None if joints is None else tuple(joints)})


def _list(joints: tuple[Mapping[str, Any], ...] | None) -> list[Mapping[str, Any]] | None:
    return None if joints is None else list(joints)
