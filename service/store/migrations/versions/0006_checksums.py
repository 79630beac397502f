"""Checksums of rows, the end of sessions, and a row to try writes on. Rows that are there have no checksum."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
NUMBER = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
SEALED = (
    "blobs",
    "models",
    "sessions",
    "backgrounds",
    "frames",
    "frame_bodies",
    "estimates",
    "particles",
    "beliefs",
    "contenders",
    "events",
)


def upgrade() -> None:
    """Add the columns and the table."""
    for table in SEALED:
        op.add_column(table, sa.Column("checksum", sa.String))
    op.add_column("sessions", sa.Column("ended_at", sa.String))
    op.create_table(
        "probes",
        sa.Column("id", sa.Integer, nullable=False, autoincrement=False),
        sa.Column("count", NUMBER, nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_probes"),
    )


def downgrade() -> None:
    """Drop them."""
    op.drop_table("probes")
    op.drop_column("sessions", "ended_at")
    for table in SEALED:
        op.drop_column(table, "checksum")
