"""a study's vessel library: mugs and bowls that were measured once

Revision ID: 20261123_study_vessels
Revises: 20261122_study_day_sums
Create Date: 2026-11-23 01:00:00
"""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "20261123_study_vessels"
down_revision = "20261122_study_day_sums"
branch_labels = None
depends_on = None

KINDS = "'mug', 'cup', 'glass', 'tall_glass', 'bowl', 'soup_bowl', 'deep_plate', 'other'"


def upgrade() -> None:
    op.create_table(
        "study_vessel",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("name", sa.String(100), nullable=False),
        sa.Column("name_key", sa.String(300), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_study_vessel_study_id_study")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_study_vessel")),
    )
    op.create_index(op.f("ix_study_vessel_study_id_name_key"), "study_vessel", ["study_id", "name_key"], unique=True)
    op.create_table(
        "study_vessel_version",
        sa.Column("vessel_id", sa.Uuid(), nullable=False),
        sa.Column("version", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("kind", sa.String(16), nullable=False),
        sa.Column("rim_diameter_mm", sa.Double(), nullable=False),
        sa.Column("height_mm", sa.Double(), nullable=False),
        sa.Column("capacity_ml", sa.Double(), nullable=True),
        sa.Column("fill_line_mm", sa.Double(), nullable=True),
        sa.Column("fill_line_ml", sa.Double(), nullable=True),
        sa.Column(
            "inside_profile_mm",
            sa.JSON(none_as_null=True).with_variant(postgresql.JSONB(none_as_null=True), "postgresql"),
            nullable=False,
        ),
        sa.Column("is_retired", sa.Boolean(), nullable=False),
        sa.Column("author", sa.String(200), nullable=False),
        sa.Column("changed_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint(f"kind IN ({KINDS})", name=op.f("ck_study_vessel_version_kind")),
        sa.CheckConstraint(
            "(fill_line_mm IS NULL) = (fill_line_ml IS NULL)", name=op.f("ck_study_vessel_version_whole_fill_line")
        ),
        sa.ForeignKeyConstraint(
            ["vessel_id"], ["study_vessel.id"], name=op.f("fk_study_vessel_version_vessel_id_study_vessel")
        ),
        sa.PrimaryKeyConstraint("vessel_id", "version", name=op.f("pk_study_vessel_version")),
    )


def downgrade() -> None:
    op.drop_table("study_vessel_version")
    op.drop_table("study_vessel")
