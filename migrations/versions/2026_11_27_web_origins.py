"""origins of web apps that a study allows

Revision ID: 20261127_web_origins
Revises: 20261127_depth_maps
Create Date: 2026-11-27 13:55:00
"""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "20261127_web_origins"
down_revision = "20261127_depth_maps"
branch_labels = None
depends_on = None

JSON = sa.JSON(none_as_null=True).with_variant(postgresql.JSONB(none_as_null=True), "postgresql")


def upgrade() -> None:
    op.add_column("study", sa.Column("web_origins", JSON, nullable=True))


def downgrade() -> None:
    op.drop_column("study", "web_origins")
