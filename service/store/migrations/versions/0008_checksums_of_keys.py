"""Checksums of keys and of the audit log. Rows that are there have none."""

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
SEALED = ("api_keys", "audit")


def upgrade() -> None:
    """Add the columns."""
    for table in SEALED:
        op.add_column(table, sa.Column("checksum", sa.String))


def downgrade() -> None:
    """Drop them."""
    for table in SEALED:
        op.drop_column(table, "checksum")
