"""whose turn it is: jobs of studies that share workers take turns

The column keeps its server default, so that a process of the version before can still queue meals beside a newer one.

Revision ID: 20261122_fair_turns
Revises: 20261121_identification
Create Date: 2026-11-22 00:00:00
"""

import sqlalchemy as sa
from alembic import op

revision = "20261122_fair_turns"
down_revision = "20261121_identification"
branch_labels = None
depends_on = None


def upgrade() -> None:
    with op.batch_alter_table("job") as batch_op:
        batch_op.add_column(sa.Column("turn", sa.BigInteger(), nullable=False, server_default="0"))


def downgrade() -> None:
    with op.batch_alter_table("job") as batch_op:
        batch_op.drop_column("turn")
