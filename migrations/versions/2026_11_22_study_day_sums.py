"""what a study's day comes to is kept, so that a year of a million records is told at once

Quick: the sums are not made in here. All days that have a participant's sum are marked (those that are marked
themselves follow when their sums are written), and whoever asks meanwhile counts marked days as before.

A trigger marks a study's days where a participant's first or last day changes. On SQLite a later migration that makes
`participant` anew (batch_alter_table) drops it: it must make it again, with `make_trigger`.

Revision ID: 20261122_study_day_sums
Revises: 20261122_releases
Create Date: 2026-11-22 10:20:00
"""

import sqlalchemy as sa
from alembic import op

revision = "20261122_study_day_sums"
down_revision = "20261122_releases"
branch_labels = None
depends_on = None

COUNTS = ("told", "told_closed", "with_meal", "closed", "ate_nothing", "open_days")
SUMS = (
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
    "items",
    "unmeasured_items",
    "provisional_items",
)
RUNS = (
    "delays",
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
MARK_ALL = """
    INSERT INTO study_day_mark (study_id, local_date)
    SELECT DISTINCT study_id, local_date FROM day_sum ORDER BY local_date
"""
# a comparison with NULL chooses no day
MARK_OF_PERSON = """
    INSERT INTO study_day_mark (study_id, local_date)
    SELECT study_id, local_date FROM day_sum WHERE participant_id = NEW.id AND (
        local_date < OLD.starts_on OR local_date < NEW.starts_on
        OR local_date > {old_day} OR local_date > {new_day}
    );
"""
DAY = {"sqlite": "date({row}.withdrawn_at)", "postgresql": "CAST({row}.withdrawn_at AT TIME ZONE 'UTC' AS DATE)"}


def upgrade() -> None:
    op.create_table(
        "study_day_sum",
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("local_date", sa.Date(), nullable=False),
        *(sa.Column(name, sa.Integer(), nullable=False) for name in COUNTS),
        sa.Column("open_energy_kcal", sa.Double(), nullable=True),
        *(sa.Column(name, sa.Integer(), nullable=False) for name in SUMS),
        *(sa.Column(name, sa.LargeBinary(), nullable=False) for name in RUNS),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_study_day_sum_study_id_study")),
        sa.PrimaryKeyConstraint("study_id", "local_date", name=op.f("pk_study_day_sum")),
    )
    if op.get_bind().dialect.name == "postgresql":
        for name in RUNS:  # doubles do not get smaller, and reading them would take their unpacking
            op.execute(f"ALTER TABLE study_day_sum ALTER COLUMN {name} SET STORAGE EXTERNAL")
    op.create_table(
        "study_day_mark",
        sa.Column("id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("local_date", sa.Date(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_study_day_mark")),
    )
    make_trigger()
    op.execute(MARK_ALL)
    op.create_index(op.f("ix_study_day_mark_study_id_local_date"), "study_day_mark", ["study_id", "local_date"])


def downgrade() -> None:
    if op.get_bind().dialect.name == "sqlite":
        op.execute("DROP TRIGGER participant_marks_study_days")
    else:
        op.execute("DROP TRIGGER participant_marks_study_days ON participant")
        op.execute("DROP FUNCTION mark_study_days()")
    op.drop_table("study_day_mark")
    op.drop_table("study_day_sum")


def make_trigger() -> None:
    """Let a change of a participant's first or last day mark the study's days that it bears on."""
    dialect = op.get_bind().dialect.name
    mark = MARK_OF_PERSON.format(**{f"{row.lower()}_day": DAY[dialect].format(row=row) for row in ("OLD", "NEW")})
    head = "CREATE TRIGGER participant_marks_study_days AFTER UPDATE OF starts_on, withdrawn_at ON participant"
    if dialect == "sqlite":
        op.execute(f"{head} BEGIN {mark} END")
        return
    op.execute(
        f"CREATE FUNCTION mark_study_days() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN {mark} RETURN NULL; END $$"
    )
    op.execute(f"{head} FOR EACH ROW EXECUTE FUNCTION mark_study_days()")
