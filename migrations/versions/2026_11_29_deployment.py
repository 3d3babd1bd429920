"""one row about the deployment: its key and its clock

Revision ID: 20261129_deployment
Revises: 20261127_record_pages
Create Date: 2026-11-29 01:40:00
"""

import sqlalchemy as sa
from alembic import op

revision = "20261129_deployment"
down_revision = "20261127_record_pages"
branch_labels = None
depends_on = None


def upgrade() -> None:
    deployment = op.create_table(
        "deployment",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("key_check", sa.String(64), nullable=True),
        sa.Column("clock_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("clock_doubted_seconds", sa.Double(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_deployment")),
    )
    op.bulk_insert(deployment, [{"id": 1, "clock_doubted_seconds": 0.0}])


def downgrade() -> None:
    op.drop_table("deployment")
