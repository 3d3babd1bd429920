"""participants' codes that are never given again, since whoever had them was erased

Revision ID: 20261123_spent_codes
Revises: 20261123_study_vessels
Create Date: 2026-11-23 02:00:00
"""

import sqlalchemy as sa
from alembic import op

revision = "20261123_spent_codes"
down_revision = "20261123_study_vessels"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "spent_code",
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("digest", sa.String(64), nullable=False),
        sa.Column("spent_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_spent_code_study_id_study")),
        sa.PrimaryKeyConstraint("study_id", "digest", name=op.f("pk_spent_code")),
    )


def downgrade() -> None:
    op.drop_table("spent_code")
