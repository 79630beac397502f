"""Keys may have rates of their own."""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"


def upgrade() -> None:
    """Add the column; keys of before go by the settings."""
    op.add_column("api_keys", sa.Column("rates", sa.JSON))


def downgrade() -> None:
    """Drop it."""
    op.drop_column("api_keys", "rates")
