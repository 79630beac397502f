"""The schema. Migrations build it; a test holds the two together."""

from __future__ import annotations

from sqlalchemy import (
    JSON,
    BigInteger,
    Column,
    Float,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Table,
    UniqueConstraint,
)

metadata = MetaData(
    naming_convention={
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "fk": "fk_%(table_name)s_%(column_0_name)s",
        "pk": "pk_%(table_name)s",
    }
)

Number = BigInteger().with_variant(Integer(), "sqlite")
"""Up to 2**63: what counts, and what a client may name. SQLite's INTEGER is as wide, and only it can count up."""


CHANGES = {"changes": True}
"""Marks columns that are not under the row's checksum (``seal``): they change, or the database gives them."""


def _checksum() -> Column[str]:
    """None in rows of releases before there were checksums."""
    return Column("checksum", String)


def _of_session() -> Column[str]:
    return Column("session_id", String, ForeignKey("sessions.id", ondelete="CASCADE"), primary_key=True, nullable=False)


blobs = Table(
    "blobs",
    metadata,
    Column("key", String, primary_key=True),
    Column("data", LargeBinary, nullable=False),
    _checksum(),
)

models = Table(
    "models",
    metadata,
    Column("number", Number, primary_key=True, autoincrement=True, info=CHANGES),
    Column("id", String, nullable=False, unique=True),
    Column("name", String, nullable=False),
    Column("file_type", String, nullable=False),
    Column("blob_key", String, ForeignKey("blobs.key"), nullable=False),
    Column("joints", JSON),
    Column("report", JSON, nullable=False),
    Column("created_at", String, nullable=False),
    Column("tenant", String, nullable=False, server_default="default"),
    _checksum(),
    Index("ix_models_tenant_number", "tenant", "number"),
    sqlite_autoincrement=True,
)

sessions = Table(
    "sessions",
    metadata,
    Column("number", Number, primary_key=True, autoincrement=True, info=CHANGES),
    Column("id", String, nullable=False, unique=True),
    Column("model_id", String, ForeignKey("models.id"), nullable=False),
    Column("name", String),
    Column("config", JSON, nullable=False),
    Column("warnings", JSON, nullable=False),
    Column("created_at", String, nullable=False),
    Column("updated_at", String, nullable=False, info=CHANGES),
    Column("epoch", Number, nullable=False, info=CHANGES),
    Column("next_index", Number, nullable=False, info=CHANGES),
    Column("next_seq", Number, nullable=False, info=CHANGES),
    Column("status", String, info=CHANGES),
    Column("time_s", Float, info=CHANGES),
    Column("time_given", String, info=CHANGES),
    Column("background_key", String, ForeignKey("blobs.key"), info=CHANGES),
    Column("background_frames", Integer, nullable=False, info=CHANGES),
    Column("background_info", JSON, info=CHANGES),
    Column("tenant", String, nullable=False, server_default="default"),
    Column("ended_at", String, info=CHANGES),
    _checksum(),
    Index("ix_sessions_tenant_number", "tenant", "number"),
    sqlite_autoincrement=True,
)

backgrounds = Table(
    "backgrounds",
    metadata,
    _of_session(),
    Column("ordinal", Integer, primary_key=True),
    Column("sha256", String, nullable=False),
    Column("idempotency_key", String),
    Column("frames", Integer, nullable=False),
    Column("created_at", String, nullable=False),
    _checksum(),
    UniqueConstraint("session_id", "idempotency_key"),
)

frames = Table(
    "frames",
    metadata,
    _of_session(),
    Column("idx", Number, primary_key=True, autoincrement=False),
    Column("sha256", String, nullable=False),
    Column("idempotency_key", String),
    Column("media_type", String, nullable=False),
    Column("time", String, nullable=False),
    Column("time_s", Float, nullable=False),
    Column("query", JSON, nullable=False),
    Column("created_at", String, nullable=False),
    Column("epoch", Number, nullable=False),
    _checksum(),
    UniqueConstraint("session_id", "idempotency_key"),
)

frame_bodies = Table(
    "frame_bodies",
    metadata,
    _of_session(),
    Column("idx", Number, primary_key=True, autoincrement=False),
    Column("body", LargeBinary, nullable=False),
    _checksum(),
)

estimates = Table(
    "estimates",
    metadata,
    _of_session(),
    Column("idx", Number, primary_key=True, autoincrement=False),
    Column("document", LargeBinary, nullable=False),
    _checksum(),
)

particles = Table(
    "particles",
    metadata,
    _of_session(),
    Column("idx", Number, primary_key=True, autoincrement=False),
    Column("state", LargeBinary, nullable=False),
    _checksum(),
)

beliefs = Table(
    "beliefs",
    metadata,
    _of_session(),
    Column("idx", Number, primary_key=True, autoincrement=False),
    Column("belief", LargeBinary, nullable=False),
    _checksum(),
)

objects = Table(
    "objects",
    metadata,
    Column("number", Number, primary_key=True, autoincrement=True, info=CHANGES),
    Column("id", String, nullable=False, unique=True),
    Column("name", String, nullable=False),
    Column("created_at", String, nullable=False),
    Column("tenant", String, nullable=False),
    _checksum(),
    Index("ix_objects_tenant_number", "tenant", "number"),
    sqlite_autoincrement=True,
)
"""What several sessions are of."""

members = Table(
    "members",
    metadata,
    Column("object_id", String, ForeignKey("objects.id", ondelete="CASCADE"), primary_key=True, nullable=False),
    _of_session(),
    _checksum(),
)

contenders = Table(
    "contenders",
    metadata,
    _of_session(),
    Column("ordinal", Integer, primary_key=True, autoincrement=False),
    Column("model_id", String, ForeignKey("models.id"), nullable=False),
    Column("state", LargeBinary),
    Column("log_evidence", Float, nullable=False),
    _checksum(),
)

events = Table(
    "events",
    metadata,
    _of_session(),
    Column("seq", Number, primary_key=True, autoincrement=False),
    Column("kind", String, nullable=False),
    Column("idx", Number, nullable=False),
    _checksum(),
)

api_keys = Table(
    "api_keys",
    metadata,
    Column("number", Number, primary_key=True, autoincrement=True, info=CHANGES),
    Column("id", String, nullable=False, unique=True),
    Column("sha256", String, nullable=False),
    Column("tenant", String, nullable=False),
    Column("role", String, nullable=False),
    Column("name", String, nullable=False),
    Column("created_at", String, nullable=False),
    Column("expires_at", String),
    Column("revoked_at", String, info=CHANGES),
    Column("last_used_at", String, info=CHANGES),
    Column("rates", JSON(none_as_null=True)),
    _checksum(),
    sqlite_autoincrement=True,
)

audit = Table(
    "audit",
    metadata,
    Column("number", Number, primary_key=True, autoincrement=True, info=CHANGES),
    Column("at", String, nullable=False),
    Column("tenant", String, nullable=False),
    Column("actor", String, nullable=False),
    Column("address", String, nullable=False),
    Column("action", String, nullable=False),
    Column("target", String, nullable=False),
    Column("outcome", Integer, nullable=False),
    Column("count", Integer, nullable=False),
    Column("request_id", String, nullable=False),
    _checksum(),
    Index("ix_audit_tenant_number", "tenant", "number"),
    Index("ix_audit_at", "at"),
    sqlite_autoincrement=True,
)

instances = Table(
    "instances",
    metadata,
    Column("id", String, primary_key=True),
    Column("url", String, nullable=False),
    Column("lease_until", Float, nullable=False),
)
"""Processes on this database, and until when each holds its sessions: seconds since 1970 by the database's clock."""

owners = Table(
    "owners",
    metadata,
    _of_session(),
    Column("instance", String, nullable=False),
)
"""Which process has a session in memory; it counts while that process's lease lasts."""

tickets = Table(
    "tickets",
    metadata,
    Column("digest", String, primary_key=True),
    Column("tenant", String, nullable=False),
    Column("key_id", String, nullable=False),
    Column("expires", String),
    Column("until", Float, nullable=False),
)
"""Tickets for streams, where several processes must know them; ``until`` by the database's clock."""

cluster = Table(
    "cluster",
    metadata,
    Column("id", Integer, primary_key=True, autoincrement=False),
    Column("secret", String, nullable=False),
)
"""One row: what the processes sign the calls with that they hand on to each other."""

probes = Table(
    "probes",
    metadata,
    Column("id", Integer, primary_key=True, autoincrement=False),
    Column("count", Number, nullable=False),
)
"""One row, written to learn whether the database takes writes."""
