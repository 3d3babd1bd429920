"""a study may do without context when foods are identified, and a candidate says what speaks for it

Revision ID: 20261130_context
Revises: 20261129_no_day_sums
Create Date: 2026-11-30 04:00:00
"""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "20261130_context"
down_revision = "20261129_no_day_sums"
branch_labels = None
depends_on = None

JSON = sa.JSON(none_as_null=True).with_variant(postgresql.JSONB(none_as_null=True), "postgresql")


def upgrade() -> None:
    op.add_column(
        "study",
        sa.Column("identifies_by_context", sa.Boolean(), nullable=False, server_default=sa.true()),
    )
    op.add_column("item_candidate", sa.Column("reasons", JSON, nullable=True))


def downgrade() -> None:
    op.drop_column("item_candidate", "reasons")
    op.drop_column("study", "identifies_by_context")
