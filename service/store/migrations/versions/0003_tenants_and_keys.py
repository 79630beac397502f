"""Whose each model and session is; API keys; the audit log."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
NUMBER = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    """Everything that is here belongs to the tenant ``default``."""
    for table in ("models", "sessions"):
        op.add_column(table, sa.Column("tenant", sa.String, nullable=False, server_default="default"))
        op.create_index(f"ix_{table}_tenant_number", table, ["tenant", "number"])
    _keys()
    _audit()


def downgrade() -> None:
    """Drop all of it."""
    op.drop_table("audit")
    op.drop_table("api_keys")
    for table in ("sessions", "models"):
        op.drop_index(f"ix_{table}_tenant_number", table)
        op.drop_column(table, "tenant")


def _keys() -> None:
    op.create_table(
        "api_keys",
        sa.Column("number", NUMBER, nullable=False, autoincrement=True),
        sa.Column("id", sa.String, nullable=False),
        sa.Column("sha256", sa.String, nullable=False),
        sa.Column("tenant", sa.String, nullable=False),
        sa.Column("role", sa.String, nullable=False),
        sa.Column("name", sa.String, nullable=False),
        sa.Column("created_at", sa.String, nullable=False),
        sa.Column("expires_at", sa.String),
        sa.Column("revoked_at", sa.String),
        sa.Column("last_used_at", sa.String),
        sa.PrimaryKeyConstraint("number", name="pk_api_keys"),
        sa.UniqueConstraint("id", name="uq_api_keys_id"),
        sqlite_autoincrement=True,
    )


def _audit() -> None:
    op.create_table(
        "audit",
        sa.Column("number", NUMBER, nullable=False, autoincrement=True),
        sa.Column("at", sa.String, nullable=False),
        sa.Column("tenant", sa.String, nullable=False),
        sa.Column("actor", sa.String, nullable=False),
        sa.Column("address", sa.String, nullable=False),
        sa.Column("action", sa.String, nullable=False),
        sa.Column("target", sa.String, nullable=False),
        sa.Column("outcome", sa.Integer, nullable=False),
        sa.Column("count", sa.Integer, nullable=False),
        sa.Column("request_id", sa.String, nullable=False),
        sa.PrimaryKeyConstraint("number", name="pk_audit"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_audit_tenant_number", "audit", ["tenant", "number"])
    op.create_index("ix_audit_at", "audit", ["at"])
