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


HAS_BEGUN = sa.text("turn > 0 AND started_at IS NOT NULL")
HAS_STUDY = sa.text("study_id IS NOT NULL")


def upgrade() -> None:
    with op.batch_alter_table("job") as batch_op:
        batch_op.add_column(sa.Column("turn", sa.BigInteger(), nullable=False, server_default="0"))
        batch_op.add_column(sa.Column("study_id", sa.Uuid(), nullable=True))
        batch_op.create_foreign_key(op.f("fk_job_study_id_study"), "study", ["study_id"], ["id"])
    # both hold new jobs only, so that they are made in no time beside millions of old ones
    op.create_index(
        op.f("ix_job_study_id_turn"), "job", ["study_id", "turn"], sqlite_where=HAS_STUDY, postgresql_where=HAS_STUDY
    )
    op.create_index("ix_job_turn_of_begun", "job", ["turn"], sqlite_where=HAS_BEGUN, postgresql_where=HAS_BEGUN)


def downgrade() -> None:
    op.drop_index("ix_job_turn_of_begun", "job")
    op.drop_index(op.f("ix_job_study_id_turn"), "job")
    with op.batch_alter_table("job") as batch_op:
        batch_op.drop_constraint(op.f("fk_job_study_id_study"), type_="foreignkey")
        batch_op.drop_column("study_id")
        batch_op.drop_column("turn")
