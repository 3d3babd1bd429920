"""sandbox studies

Revision ID: 20261127_sandbox
Revises: 20261127_web_origins
Create Date: 2026-11-27 16:05:00
"""

import sqlalchemy as sa
from alembic import op

from app.core.errors import ConflictError

revision = "20261127_sandbox"
down_revision = "20261127_web_origins"
branch_labels = None
depends_on = None


def upgrade() -> None:
    # with a default: the version before adds studies too while the upgrade rolls out
    op.add_column(
        "study", sa.Column("is_sandbox", sa.Boolean(), nullable=False, server_default=sa.false())
    )


def downgrade() -> None:
    count = op.get_bind().scalar(sa.text("SELECT count(*) FROM study WHERE is_sandbox"))
    if count:  # their meals would be listed among those of the other studies
        raise ConflictError(
            f"The schema cannot go back behind {revision}: the older one has no place for sandbox studies ({count})."
        )
    op.drop_column("study", "is_sandbox")
