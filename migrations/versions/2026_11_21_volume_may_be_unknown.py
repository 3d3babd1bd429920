"""a volume may be unknown

The way back has no place for an unknown volume, and nobody may make one up: it is refused while there is one.

Revision ID: 20261121_unknown_volume
Revises: 20261121_first
Create Date: 2026-11-21 13:05:00
"""

import sqlalchemy as sa
from alembic import op
from alembic.operations import BatchOperations

from app.errors import ConflictError

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
    require_known_volumes()
    with op.batch_alter_table("item") as batch_op:
        batch_op.drop_constraint(op.f("ck_item_volume_with_interval"), type_="check")
        set_nullable(batch_op, nullable=False)
    with op.batch_alter_table("effective_record") as batch_op:
        set_nullable(batch_op, nullable=False)


def set_nullable(batch_op: BatchOperations, *, nullable: bool) -> None:
    for column in COLUMNS:
        batch_op.alter_column(column, existing_type=sa.Double(), nullable=nullable)


def require_known_volumes() -> None:
    """Raises ConflictError where a row has no volume, before anything is changed."""
    for table in ("item", "effective_record"):
        without = sa.or_(*(sa.column(column).is_(None) for column in COLUMNS))
        count = op.get_bind().scalar(sa.select(sa.func.count()).select_from(sa.table(table)).where(without))
        if count:
            raise ConflictError(
                f"The schema cannot go back behind {revision}: {count} rows of {table} have no volume, and the older "
                "schema has no place for that. Nothing was changed; a restore of a backup is the way back."
            )
