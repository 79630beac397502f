"""Whose row it is. The tenant is part of the key of every model and session, so no query can miss to ask for it.

Outside an id belongs to a tenant; inside, a row's key says both. The types keep the two apart: the queries take keys,
and only ``session_key``, ``model_key`` and ``object_key`` make them. Rows of the tenant ``default`` have the plain id
as their key, others ``tenant/id``; an id has no slash, so no tenant can write another's key.
"""

from __future__ import annotations

import re
from typing import NewType

from service.errors import NotFoundError

SessionKey = NewType("SessionKey", str)
ModelKey = NewType("ModelKey", str)
ObjectKey = NewType("ObjectKey", str)

DEFAULT_TENANT = "default"
TENANT_PATTERN = r"[a-z0-9][a-z0-9_-]{0,31}"
_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")


def session_key(tenant: str, session_id: str) -> SessionKey:
    """The key of a tenant's session. Raises ``NotFoundError`` for what cannot be an id."""
    return SessionKey(_key(tenant, session_id, "session", "session_id"))


def model_key(tenant: str, model_id: str) -> ModelKey:
    """The key of a tenant's model. Raises ``NotFoundError`` for what cannot be an id."""
    return ModelKey(_key(tenant, model_id, "model", "model_id"))


def object_key(tenant: str, object_id: str) -> ObjectKey:
    """The key of a tenant's object. Raises ``NotFoundError`` for what cannot be an id."""
    return ObjectKey(_key(tenant, object_id, "object", "object_id"))


def public_id(key: SessionKey | ModelKey | ObjectKey) -> str:
    """The id as its tenant knows it."""
    return key.rpartition("/")[2]


def tenant_of(key: SessionKey | ModelKey | ObjectKey) -> str:
    """Whose the row is."""
    return key.rpartition("/")[0] or DEFAULT_TENANT


def _key(tenant: str, given: str, what: str, field: str) -> str:
    if not _ID.fullmatch(given):
        raise NotFoundError(f"no {what} {given}", field=field)
    return given if tenant == DEFAULT_TENANT else f"{tenant}/{given}"
