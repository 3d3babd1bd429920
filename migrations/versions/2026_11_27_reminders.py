"""reminders by Web Push: a study's times, and phones' subscriptions

On the way back the subscriptions end: phones make them again.

Revision ID: 20261127_reminders
Revises: 20261127_voice_notes
Create Date: 2026-11-27 16:55:00
"""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "20261127_reminders"
down_revision = "20261127_voice_notes"
branch_labels = None
depends_on = None

JSON = sa.JSON(none_as_null=True).with_variant(postgresql.JSONB(none_as_null=True), "postgresql")


def upgrade() -> None:
    op.add_column("study", sa.Column("reminder_times", JSON, nullable=True))
    op.create_table(
        "push_subscription",
        sa.Column("device_id", sa.Uuid(), nullable=False),
        sa.Column("endpoint", sa.String(500), nullable=False),
        sa.Column("public_key", sa.String(100), nullable=False),
        sa.Column("auth", sa.String(40), nullable=False),
        sa.Column("times", JSON, nullable=True),
        sa.Column("after_meal", sa.Boolean(), nullable=False),
        sa.Column("time_zone", sa.String(64), nullable=False),
        sa.Column("quiet_from_minutes", sa.Integer(), nullable=False),
        sa.Column("quiet_until_minutes", sa.Integer(), nullable=False),
        sa.Column("next_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("after_reminded_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(
            ["device_id"],
            ["device.id"],
            name=op.f("fk_push_subscription_device_id_device"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("device_id", name=op.f("pk_push_subscription")),
    )
    op.create_index(op.f("ix_push_subscription_next_at"), "push_subscription", ["next_at"])


def downgrade() -> None:
    op.drop_table("push_subscription")
    op.drop_column("study", "reminder_times")
