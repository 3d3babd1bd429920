"""days are summed when they are read: stored sums, their marks and triggers go

Revision ID: 20261129_no_day_sums
Revises: 20261129_days_of_records
Create Date: 2026-11-29 14:40:00
"""

from collections.abc import Iterator

import sqlalchemy as sa
from alembic import op

revision = "20261129_no_day_sums"
down_revision = "20261129_days_of_records"
branch_labels = None
depends_on = None

CONTRACTS = "0.5.0"

BIG_ID = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
MARKING = ("meal", "effective_record", "diary_day")
TABLES = ("study_day_mark", "study_day_sum", "day_mark", "day_sum")
OLD_INDEX = "ix_effective_record_participant_id_local_date"
HEADLINES = (
    "energy_kcal",
    "protein_g",
    "fat_g",
    "carbohydrate_g",
    "fibre_g",
    "sugar_g",
    "saturated_fat_g",
    "sodium_mg",
    "potassium_mg",
    "vitamin_c_mg",
)
MEALS = (
    "meals",
    "receiving_meals",
    "queued_meals",
    "processing_meals",
    "estimated_meals",
    "needs_review_meals",
    "failed_meals",
    "confirmed_meals",
    "late_meals",
    "located_meals",
    "unmeasured_meals",
)
ITEMS = ("items", "unmeasured_items", "provisional_items")
STUDY_DAYS = ("told", "told_closed", "with_meal", "closed", "ate_nothing", "open_days")


def upgrade() -> None:
    if op.get_bind().dialect.name == "sqlite":
        for name in ("participant_marks_study_days", *_sqlite_triggers()):
            op.execute(f"DROP TRIGGER IF EXISTS {name}")
    else:
        for table in MARKING:
            op.execute(f"DROP TRIGGER IF EXISTS {table}_marks_day ON {table}")
        op.execute("DROP TRIGGER IF EXISTS participant_marks_study_days ON participant")
        op.execute("DROP FUNCTION IF EXISTS mark_day()")
        op.execute("DROP FUNCTION IF EXISTS mark_study_days()")
    for table in TABLES:
        op.drop_table(table)
    op.drop_index(OLD_INDEX, "effective_record")


def _sqlite_triggers() -> Iterator[str]:
    for table in MARKING:
        for verb in ("insert", "update", "delete"):
            yield f"{table}_marks_day_{verb}"


def downgrade() -> None:
    """Without triggers and sums: nothing reads them before the next upgrade takes them away again."""
    op.create_index(OLD_INDEX, "effective_record", ["participant_id", "local_date"])
    op.create_table(
        "day_sum",
        _participant(),
        sa.Column("local_date", sa.Date(), nullable=False),
        _study(),
        sa.Column("status", sa.String(length=16), nullable=False),
        sa.Column("said_nothing", sa.Boolean(), nullable=False),
        *_counts(*MEALS, "meals_after_closing", *ITEMS, "unseen_leftovers_items"),
        *_doubles("median_upload_delay_seconds", "consumed_g", *HEADLINES),
        *_doubles(*(f"{name}_coverage" for name in HEADLINES)),
        sa.CheckConstraint("status IN ('open', 'closed')", name=op.f("ck_day_sum_status")),
        sa.PrimaryKeyConstraint("participant_id", "local_date", name=op.f("pk_day_sum")),
    )
    op.create_table(
        "study_day_sum",
        _study(),
        sa.Column("local_date", sa.Date(), nullable=False),
        *_counts(*STUDY_DAYS, *MEALS, *ITEMS),
        *_doubles("open_energy_kcal"),
        *(sa.Column(name, sa.LargeBinary(), nullable=False) for name in ("delays", *HEADLINES)),
        sa.PrimaryKeyConstraint("study_id", "local_date", name=op.f("pk_study_day_sum")),
    )
    for table, columns in {
        "day_mark": ("participant_id", "study_id"),
        "study_day_mark": ("study_id",),
    }.items():
        op.create_table(
            table,
            sa.Column("id", BIG_ID, autoincrement=True, nullable=False),
            *(sa.Column(name, sa.Uuid(), nullable=False) for name in columns),
            sa.Column("local_date", sa.Date(), nullable=False),
            sa.PrimaryKeyConstraint("id", name=op.f(f"pk_{table}")),
        )


def _participant() -> sa.Column[object]:
    return sa.Column(
        "participant_id",
        sa.Uuid(),
        sa.ForeignKey("participant.id", ondelete="CASCADE"),
        nullable=False,
    )


def _study() -> sa.Column[object]:
    return sa.Column("study_id", sa.Uuid(), sa.ForeignKey("study.id"), nullable=False)


def _counts(*names: str) -> Iterator[sa.Column[int]]:
    for name in names:
        yield sa.Column(name, sa.Integer(), nullable=False)


def _doubles(*names: str) -> Iterator[sa.Column[float]]:
    for name in names:
        yield sa.Column(name, sa.Double(), nullable=True)
