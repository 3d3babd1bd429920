"""a participant's arm and visit, and why they are left out of the analysis

Revision ID: 20261130_arms
Revises: 20261130_reference
Create Date: 2026-11-30 12:00:00
"""

import sqlalchemy as sa
from alembic import op

revision = "20261130_arms"
down_revision = "20261130_reference"
branch_labels = None
depends_on = None


def upgrade() -> None:
    for name, length in (("arm", 64), ("visit", 64), ("excluded", 200)):
        op.add_column("participant", sa.Column(name, sa.String(length), nullable=True))


def downgrade() -> None:
    for name in ("excluded", "visit", "arm"):
        op.drop_column("participant", name)
