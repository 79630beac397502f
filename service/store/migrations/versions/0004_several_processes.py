"""Several processes on one database: who they are, which sessions each holds, and what they must share."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"


def upgrade() -> None:
    """Create the tables; a single process leaves them empty."""
    op.create_table(
        "instances",
        sa.Column("id", sa.String, nullable=False),
        sa.Column("url", sa.String, nullable=False),
        sa.Column("lease_until", sa.Float, nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_instances"),
    )
    op.create_table(
        "owners",
        sa.Column("session_id", sa.String, nullable=False),
        sa.Column("instance", sa.String, nullable=False),
        sa.PrimaryKeyConstraint("session_id", name="pk_owners"),
        sa.ForeignKeyConstraint(["session_id"], ["sessions.id"], name="fk_owners_session_id", ondelete="CASCADE"),
    )
    op.create_table(
        "tickets",
        sa.Column("digest", sa.String, nullable=False),
        sa.Column("tenant", sa.String, nullable=False),
        sa.Column("key_id", sa.String, nullable=False),
        sa.Column("expires", sa.String),
        sa.Column("until", sa.Float, nullable=False),
        sa.PrimaryKeyConstraint("digest", name="pk_tickets"),
    )
    op.create_table(
        "cluster",
        sa.Column("id", sa.Integer, nullable=False, autoincrement=False),
        sa.Column("secret", sa.String, nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_cluster"),
    )


def downgrade() -> None:
    """Drop them."""
    for name in ("cluster", "tickets", "owners", "instances"):
        op.drop_table(name)
