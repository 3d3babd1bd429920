"""stereo rigs beside cameras, and runs without a marker

A rig is a calibration with `rig`; those that staff upload have a study and no phone. A run by a rig has no marker. The
older schema has no place for either: the way back is refused while there are any.

Revision ID: 20261127_rigs
Revises: 20261127_reshape
Create Date: 2026-11-27 01:10:00
"""

import sqlalchemy as sa
from alembic import op
from alembic.operations import BatchOperations
from sqlalchemy.dialects import postgresql

from app.core.errors import ConflictError
from app.db.migrate import create_triggers

revision = "20261127_rigs"
down_revision = "20261127_reshape"
branch_labels = None
depends_on = None

JSON = sa.JSON(none_as_null=True).with_variant(postgresql.JSONB(none_as_null=True), "postgresql")
STUDY_KEY, STUDY_INDEX = "fk_camera_calibration_study_id_study", "ix_camera_calibration_study_id"


def upgrade() -> None:
    with op.batch_alter_table("run") as batch:
        batch.alter_column("marker", existing_type=sa.String(length=64), nullable=True)
    with op.batch_alter_table("camera_calibration") as batch:
        _set_nullable(batch, nullable=True)
        batch.add_column(sa.Column("rig", JSON, nullable=True))
        batch.add_column(sa.Column("study_id", sa.Uuid(), nullable=True))
        batch.create_foreign_key(op.f(STUDY_KEY), "study", ["study_id"], ["id"])
        batch.create_index(op.f(STUDY_INDEX), ["study_id"])
    create_triggers(op.get_bind())


def downgrade() -> None:
    _require_none("run", "marker IS NULL", "runs without a marker")
    without = "marker IS NULL OR rms_px IS NULL OR photographs IS NULL"
    _require_none("camera_calibration", f"rig IS NOT NULL OR {without}", "rigs")
    with op.batch_alter_table("camera_calibration") as batch:
        batch.drop_index(op.f(STUDY_INDEX))
        batch.drop_constraint(op.f(STUDY_KEY), type_="foreignkey")
        batch.drop_column("study_id")
        batch.drop_column("rig")
        _set_nullable(batch, nullable=False)
    with op.batch_alter_table("run") as batch:
        batch.alter_column("marker", existing_type=sa.String(length=64), nullable=False)
    create_triggers(op.get_bind())


def _set_nullable(batch: BatchOperations, *, nullable: bool) -> None:
    for name, column_type in (
        ("marker", sa.String(length=64)),
        ("rms_px", sa.Double()),
        ("photographs", sa.Integer()),
    ):
        batch.alter_column(name, existing_type=column_type, nullable=nullable)


def _require_none(table: str, condition: str, what: str) -> None:
    """Raise ConflictError if a row meets the condition, before anything is changed."""
    query = sa.select(sa.func.count()).select_from(sa.table(table)).where(sa.text(condition))
    count = op.get_bind().scalar(query)
    if count:
        raise ConflictError(
            f"The schema cannot go back behind {revision}: the older one has no place for {what} ({count}). "
            "Nothing was changed; a restore of a backup is the way back."
        )
