"""First schema: models, sessions, frames, estimates, particles, events."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
NUMBER = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    """Create every table."""
    op.create_table(
        "blobs",
        sa.Column("key", sa.String, nullable=False),
        sa.Column("data", sa.LargeBinary, nullable=False),
        sa.PrimaryKeyConstraint("key", name="pk_blobs"),
    )
    _models_and_sessions()
    _frames()
    _history()


def downgrade() -> None:
    """Drop every table."""
    for name in ("events", "particles", "estimates", "frame_bodies", "frames", "backgrounds"):
        op.drop_table(name)
    for name in ("sessions", "models", "blobs"):
        op.drop_table(name)


def _models_and_sessions() -> None:
    op.create_table(
        "models",
        sa.Column("number", NUMBER, nullable=False, autoincrement=True),
        sa.Column("id", sa.String, nullable=False),
        sa.Column("name", sa.String, nullable=False),
        sa.Column("file_type", sa.String, nullable=False),
        sa.Column("blob_key", sa.String, nullable=False),
        sa.Column("joints", sa.JSON),
        sa.Column("report", sa.JSON, nullable=False),
        sa.Column("created_at", sa.String, nullable=False),
        sa.PrimaryKeyConstraint("number", name="pk_models"),
        sa.UniqueConstraint("id", name="uq_models_id"),
        sa.ForeignKeyConstraint(["blob_key"], ["blobs.key"], name="fk_models_blob_key"),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "sessions",
        sa.Column("number", NUMBER, nullable=False, autoincrement=True),
        sa.Column("id", sa.String, nullable=False),
        sa.Column("model_id", sa.String, nullable=False),
        sa.Column("name", sa.String),
        sa.Column("config", sa.JSON, nullable=False),
        sa.Column("warnings", sa.JSON, nullable=False),
        sa.Column("created_at", sa.String, nullable=False),
        sa.Column("updated_at", sa.String, nullable=False),
        sa.Column("epoch", NUMBER, nullable=False),
        sa.Column("next_index", NUMBER, nullable=False),
        sa.Column("next_seq", NUMBER, nullable=False),
        sa.Column("status", sa.String),
        sa.Column("time_s", sa.Float),
        sa.Column("time_given", sa.String),
        sa.Column("background_key", sa.String),
        sa.Column("background_frames", sa.Integer, nullable=False),
        sa.Column("background_info", sa.JSON),
        sa.PrimaryKeyConstraint("number", name="pk_sessions"),
        sa.UniqueConstraint("id", name="uq_sessions_id"),
        sa.ForeignKeyConstraint(["model_id"], ["models.id"], name="fk_sessions_model_id"),
        sa.ForeignKeyConstraint(["background_key"], ["blobs.key"], name="fk_sessions_background_key"),
        sqlite_autoincrement=True,
    )


def _of_session(table: str, *columns: sa.Column[object], key: str, unique: bool = False) -> None:
    constraints: list[sa.Constraint] = [
        sa.PrimaryKeyConstraint("session_id", key, name=f"pk_{table}"),
        sa.ForeignKeyConstraint(["session_id"], ["sessions.id"], name=f"fk_{table}_session_id", ondelete="CASCADE"),
    ]
    if unique:
        name = f"uq_{table}_session_id_idempotency_key"
        constraints.append(sa.UniqueConstraint("session_id", "idempotency_key", name=name))
    op.create_table(
        table,
        sa.Column("session_id", sa.String, nullable=False),
        sa.Column(key, sa.Integer if key == "ordinal" else NUMBER, nullable=False, autoincrement=False),
        *columns,
        *constraints,
    )


def _frames() -> None:
    _of_session(
        "backgrounds",
        sa.Column("sha256", sa.String, nullable=False),
        sa.Column("idempotency_key", sa.String),
        sa.Column("frames", sa.Integer, nullable=False),
        sa.Column("created_at", sa.String, nullable=False),
        key="ordinal",
        unique=True,
    )
    _of_session(
        "frames",
        sa.Column("sha256", sa.String, nullable=False),
        sa.Column("idempotency_key", sa.String),
        sa.Column("media_type", sa.String, nullable=False),
        sa.Column("time", sa.String, nullable=False),
        sa.Column("time_s", sa.Float, nullable=False),
        sa.Column("query", sa.JSON, nullable=False),
        sa.Column("created_at", sa.String, nullable=False),
        sa.Column("epoch", NUMBER, nullable=False),
        key="idx",
        unique=True,
    )
    _of_session("frame_bodies", sa.Column("body", sa.LargeBinary, nullable=False), key="idx")


def _history() -> None:
    _of_session("estimates", sa.Column("document", sa.LargeBinary, nullable=False), key="idx")
    _of_session("particles", sa.Column("state", sa.LargeBinary, nullable=False), key="idx")
    _of_session(
        "events",
        sa.Column("kind", sa.String, nullable=False),
        sa.Column("idx", NUMBER, nullable=False),
        key="seq",
    )
