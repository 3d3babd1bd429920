"""days by a reference method, which an owner uploads

Revision ID: 20261130_reference
Revises: 20261130_double
Create Date: 2026-11-30 13:00:00
"""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "20261130_reference"
down_revision = "20261130_double"
branch_labels = None
depends_on = None

JSON = sa.JSON(none_as_null=True).with_variant(postgresql.JSONB(none_as_null=True), "postgresql")


def upgrade() -> None:
    op.create_table(
        "reference_day",
        sa.Column("participant_id", sa.Uuid(), nullable=False),
        sa.Column("local_date", sa.Date(), nullable=False),
        sa.Column("amounts", JSON, nullable=False),
        sa.ForeignKeyConstraint(
            ["participant_id"],
            ["participant.id"],
            name="fk_reference_day_participant_id_participant",
        ),
        sa.PrimaryKeyConstraint("participant_id", "local_date", name="pk_reference_day"),
    )


def downgrade() -> None:
    op.drop_table("reference_day")
