"""attempts to sign in, counted in the database by all processes and hosts together

Revision ID: 20261129_sign_in_attempts
Revises: 20261129_needs_look
Create Date: 2026-11-29 12:50:00
"""

import sqlalchemy as sa
from alembic import op

revision = "20261129_sign_in_attempts"
down_revision = "20261129_needs_look"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "sign_in_attempt",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("name_digest", sa.String(64), nullable=False),
        sa.Column("address_digest", sa.String(64), nullable=False),
        sa.Column("attempted_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("is_success", sa.Boolean(), server_default=sa.false(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_sign_in_attempt")),
    )
    for column in ("name", "address"):
        op.create_index(
            f"ix_sign_in_attempt_{column}",
            "sign_in_attempt",
            [f"{column}_digest", "attempted_at"],
        )


def downgrade() -> None:
    op.drop_table("sign_in_attempt")
