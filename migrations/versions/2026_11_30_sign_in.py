"""staff may have a second factor, and sign in with an account of their institution

Revision ID: 20261130_sign_in
Revises: 20261130_arms
Create Date: 2026-11-30 16:00:00
"""

import sqlalchemy as sa
from alembic import op

revision = "20261130_sign_in"
down_revision = "20261130_arms"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("staff", sa.Column("totp_secret", sa.String(200), nullable=True))
    op.add_column("staff", sa.Column("totp_step", sa.BigInteger(), nullable=True))
    op.add_column("staff", sa.Column("totp_wrong_step", sa.BigInteger(), nullable=True))
    op.add_column("staff", sa.Column("oidc_identity", sa.String(64), nullable=True))
    op.create_index("ix_staff_oidc_identity", "staff", ["oidc_identity"], unique=True)


def downgrade() -> None:
    op.drop_index("ix_staff_oidc_identity", table_name="staff")
    op.drop_column("staff", "oidc_identity")
    op.drop_column("staff", "totp_wrong_step")
    op.drop_column("staff", "totp_step")
    op.drop_column("staff", "totp_secret")
