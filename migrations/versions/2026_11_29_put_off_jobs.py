"""a job is put off while a fault lasts, so that it holds no worker up

Revision ID: 20261129_put_off_jobs
Revises: 20261129_deployment
Create Date: 2026-11-29 06:20:00
"""

import sqlalchemy as sa
from alembic import op

revision = "20261129_put_off_jobs"
down_revision = "20261129_deployment"
branch_labels = None
depends_on = None


def upgrade() -> None:
    for name in ("faulty_since", "not_before"):
        op.add_column("job", sa.Column(name, sa.DateTime(timezone=True), nullable=True))


def downgrade() -> None:
    for name in ("not_before", "faulty_since"):
        op.drop_column("job", name)
