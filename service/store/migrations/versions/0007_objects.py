"""Objects that several sessions are of."""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
NUMBER = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    """Add the tables."""
    op.create_table(
        "objects",
        sa.Column("number", NUMBER, autoincrement=True, nullable=False),
        sa.Column("id", sa.String, nullable=False),
        sa.Column("name", sa.String, nullable=False),
        sa.Column("created_at", sa.String, nullable=False),
        sa.Column("tenant", sa.String, nullable=False),
        sa.Column("checksum", sa.String),
        sa.PrimaryKeyConstraint("number", name="pk_objects"),
        sa.UniqueConstraint("id", name="uq_objects_id"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_objects_tenant_number", "objects", ["tenant", "number"])
    op.create_table(
        "members",
        sa.Column("object_id", sa.String, nullable=False),
        sa.Column("session_id", sa.String, nullable=False),
        sa.Column("checksum", sa.String),
        sa.PrimaryKeyConstraint("object_id", "session_id", name="pk_members"),
        sa.ForeignKeyConstraint(["object_id"], ["objects.id"], name="fk_members_object_id", ondelete="CASCADE"),
        sa.ForeignKeyConstraint(["session_id"], ["sessions.id"], name="fk_members_session_id", ondelete="CASCADE"),
    )


def downgrade() -> None:
    """Drop them."""
    op.drop_table("members")
    op.drop_table("objects")
