"""The modes of every frame's particles, for the smoother; the models that a session compares."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
NUMBER = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    """Create both tables."""
    _of_session("beliefs", "idx", sa.Column("belief", sa.LargeBinary, nullable=False))
    _of_session(
        "contenders",
        "ordinal",
        sa.Column("model_id", sa.String, nullable=False),
        sa.Column("state", sa.LargeBinary),
        sa.Column("log_evidence", sa.Float, nullable=False),
        sa.ForeignKeyConstraint(["model_id"], ["models.id"], name="fk_contenders_model_id"),
    )


def downgrade() -> None:
    """Drop both tables."""
    op.drop_table("contenders")
    op.drop_table("beliefs")


def _of_session(table: str, key: str, *items: sa.Column[object] | sa.Constraint) -> None:
    op.create_table(
        table,
        sa.Column("session_id", sa.String, nullable=False),
        sa.Column(key, sa.Integer if key == "ordinal" else NUMBER, nullable=False, autoincrement=False),
        *items,
        sa.PrimaryKeyConstraint("session_id", key, name=f"pk_{table}"),
        sa.ForeignKeyConstraint(["session_id"], ["sessions.id"], name=f"fk_{table}_session_id", ondelete="CASCADE"),
    )
