"""Who calls: a tenant, a key of it, and what that key may."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum

from service.errors import ForbiddenError
from service.store.scope import (
    DEFAULT_TENANT,
    TENANT_PATTERN,
    ModelKey,
    ObjectKey,
    SessionKey,
    model_key,
    object_key,
    public_id,
    session_key,
    tenant_of,
)

__all__ = [
    "DEFAULT_TENANT",
    "LOCAL",
    "OIDC_PREFIX",
    "TENANT_PATTERN",
    "KeyRates",
    "ModelKey",
    "ObjectKey",
    "Principal",
    "Role",
    "SessionKey",
    "public_id",
    "tenant_of",
]

OIDC_PREFIX = "oidc:"  # of the key ids of callers whom an identity provider knows


class Role(StrEnum):
    """What a key may, the least first; each may what those before it may."""

    READ = "read"
    OPERATE = "operate"
    ADMIN = "admin"

    def covers(self, other: Role) -> bool:
        """Whether this role may what the other may."""
        order = list(Role)
        return order.index(self) >= order.index(other)


@dataclass(frozen=True)
class KeyRates:
    """What one key may do in a second; 0: any amount, None: as the settings say."""

    calls_per_s: float | None = None
    megabytes_per_s: float | None = None
    megapixels_per_s: float | None = None


@dataclass(frozen=True)
class Principal:
    """The caller. ``key_id`` is an API key's id, ``oidc:<subject>``, ``bootstrap`` or ``local``; never a secret."""

    tenant: str
    key_id: str
    role: Role
    expires: datetime | None = None  # of a credential that ends by itself
    rates: KeyRates = KeyRates()

    def require(self, role: Role) -> None:
        """Raises ``ForbiddenError`` where the role is too small."""
        if not self.role.covers(role):
            raise ForbiddenError(
                f"this needs the role {role.value}; the credential has {self.role.value}",
                role=self.role.value,
                needs=role.value,
            )

    def require_operator(self) -> None:
        """Raises ``ForbiddenError`` unless this is the operator's own tenant, which may see the whole service."""
        if self.tenant != DEFAULT_TENANT:
            raise ForbiddenError(f"this needs a key of the tenant {DEFAULT_TENANT!r}", needs=DEFAULT_TENANT)

    def session(self, session_id: str) -> SessionKey:
        """The key of this tenant's session. Raises ``NotFoundError`` for what cannot be an id."""
        return session_key(self.tenant, session_id)

    def model(self, model_id: str) -> ModelKey:
        """The key of this tenant's model. Raises ``NotFoundError`` for what cannot be an id."""
        return model_key(self.tenant, model_id)

    def object(self, object_id: str) -> ObjectKey:
        """The key of this tenant's object. Raises ``NotFoundError`` for what cannot be an id."""
        return object_key(self.tenant, object_id)


LOCAL = Principal(DEFAULT_TENANT, "local", Role.ADMIN)
"""Who calls without a key where none is needed."""
