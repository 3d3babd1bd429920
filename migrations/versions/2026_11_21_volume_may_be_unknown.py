"""a volume may be unknown

Revision ID: 20261121_unknown_volume
Revises: 20261121_first
Create Date: 2026-11-21 13:05:00
"""

import sqlalchemy as sa
from alembic import op
from alembic.operations import BatchOperations

revision = "20261121_unknown_volume"
down_revision = "20261121_first"
branch_labels = None
depends_on = None

COLUMNS = ("volume_ml", "volume_low_ml", "volume_high_ml")
WITH_INTERVAL = "(volume_ml IS NULL) = (volume_low_ml IS NULL) AND (volume_ml IS NULL) = (volume_high_ml IS NULL)"


def upgrade() -> None:
    with op.batch_alter_table("item") as batch_op:
        set_nullable(batch_op, nullable=True)
        batch_op.create_check_constraint(op.f("ck_item_volume_with_interval"), WITH_INTERVAL)
    with op.batch_alter_table("effective_record") as batch_op:
        set_nullable(batch_op, nullable=True)


def downgrade() -> None:
    with op.batch_alter_table("item") as batch_op:
        batch_op.drop_constraint(op.f("ck_item_volume_with_interval"), type_="check")
        set_nullable(batch_op, nullable=False)
    with op.batch_alter_table("effective_record") as batch_op:
        set_nullable(batch_op, nullable=False)


def set_nullable(batch_op: BatchOperations, *, nullable: bool) -> None:
    for column in COLUMNS:
        batch_op.alter_column(column, existing_type=sa.Double(), nullable=nullable)
