"""what a participant-day comes to is kept, so that a study of millions of records is summed in an instant

Quick: the sums are not made in here. All days are marked, the workers write their sums in the minutes after it, and
whoever asks meanwhile counts marked days as before. Meals wait while they are marked: seconds with ten million records.

The marks are made by triggers: a server of 0.2 beside this schema makes them too. On SQLite a later migration that
makes `meal`, `effective_record` or `diary_day` anew (batch_alter_table) drops their triggers: it must make them again,
with `make_triggers`; tests/integration/db/test_day_marks.py looks for them.

Revision ID: 20261122_day_sums
Revises: 20261122_review_queue
Create Date: 2026-11-22 06:50:00
"""

import sqlalchemy as sa
from alembic import op

revision = "20261122_day_sums"
down_revision = "20261122_review_queue"
branch_labels = None
depends_on = None

STATUSES = ("open", "closed")
COUNTS = (
    "meals",
    "receiving_meals",
    "queued_meals",
    "processing_meals",
    "estimated_meals",
    "needs_review_meals",
    "failed_meals",
    "confirmed_meals",
    "meals_after_closing",
    "unmeasured_meals",
    "late_meals",
    "located_meals",
)
ITEM_COUNTS = ("items", "unmeasured_items", "provisional_items", "unseen_leftovers_items")
COMPONENTS = (
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
KEY = ("participant_id", "local_date", "study_id")
# table -> the columns whose change may change a day's sums
WATCHED = {
    "meal": (*KEY, "origin", "captured_at", "received_at", "details", "status"),
    "effective_record": (*KEY, "meal_id", "status", "origin", "provisional", "left_g", "consumed_g", *COMPONENTS),
    "diary_day": (*KEY, "status", "ate_nothing", "changed_at"),
}
MARK_ALL = """
    INSERT INTO day_mark (participant_id, local_date, study_id)
    SELECT participant_id, local_date, study_id FROM (
        SELECT participant_id, local_date, study_id FROM meal
        UNION SELECT participant_id, local_date, study_id FROM diary_day
    ) AS day ORDER BY local_date
"""
# one writer at a time: a day that is marked need not be marked again
SQLITE_MARK = """
    INSERT INTO day_mark (participant_id, local_date, study_id)
    SELECT {row}.participant_id, {row}.local_date, {row}.study_id WHERE NOT EXISTS (
        SELECT 1 FROM day_mark WHERE participant_id = {row}.participant_id AND local_date = {row}.local_date
    ){and_condition};
"""
HAS_MOVED = "(OLD.participant_id, OLD.local_date) IS NOT (NEW.participant_id, NEW.local_date)"
POSTGRES_FUNCTION = """
    CREATE FUNCTION mark_day() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN
        IF TG_OP <> 'INSERT' THEN
            IF TG_OP = 'DELETE' OR (OLD.participant_id, OLD.local_date) <> (NEW.participant_id, NEW.local_date) THEN
                INSERT INTO day_mark (participant_id, local_date, study_id)
                VALUES (OLD.participant_id, OLD.local_date, OLD.study_id);
            END IF;
        END IF;
        IF TG_OP <> 'DELETE' THEN
            INSERT INTO day_mark (participant_id, local_date, study_id)
            VALUES (NEW.participant_id, NEW.local_date, NEW.study_id);
        END IF;
        RETURN NULL;
    END $$
"""


def upgrade() -> None:
    sums = [sa.Column(name, sa.Integer(), nullable=False) for name in COUNTS]
    items = [sa.Column(name, sa.Integer(), nullable=False) for name in ITEM_COUNTS]
    amounts = [
        sa.Column(name, sa.Double(), nullable=True)
        for component in COMPONENTS
        for name in (component, f"{component}_coverage")
    ]
    op.create_table(
        "day_sum",
        sa.Column("participant_id", sa.Uuid(), nullable=False),
        sa.Column("local_date", sa.Date(), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("status", sa.String(16), nullable=False),
        sa.Column("said_nothing", sa.Boolean(), nullable=False),
        *sums,
        sa.Column("median_upload_delay_seconds", sa.Double(), nullable=True),
        *items,
        sa.Column("consumed_g", sa.Double(), nullable=True),
        *amounts,
        sa.CheckConstraint("status IN ('open', 'closed')", name=op.f("ck_day_sum_status")),
        sa.ForeignKeyConstraint(
            ["participant_id"],
            ["participant.id"],
            name=op.f("fk_day_sum_participant_id_participant"),
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_day_sum_study_id_study")),
        sa.PrimaryKeyConstraint("participant_id", "local_date", name=op.f("pk_day_sum")),
    )
    op.create_index(
        op.f("ix_day_sum_study_id_local_date_participant_id"), "day_sum", ["study_id", "local_date", "participant_id"]
    )
    op.create_table(
        "day_mark",
        sa.Column("id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("participant_id", sa.Uuid(), nullable=False),
        sa.Column("local_date", sa.Date(), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_day_mark")),
    )
    make_triggers()
    op.execute(MARK_ALL)
    op.create_index(op.f("ix_day_mark_participant_id_local_date"), "day_mark", ["participant_id", "local_date"])
    op.create_index(
        op.f("ix_day_mark_study_id_local_date_participant_id"), "day_mark", ["study_id", "local_date", "participant_id"]
    )


def downgrade() -> None:
    if op.get_bind().dialect.name == "sqlite":
        for table in WATCHED:
            for event in ("insert", "update", "delete"):
                op.execute(f"DROP TRIGGER {table}_marks_day_{event}")
    else:
        for table in WATCHED:
            op.execute(f"DROP TRIGGER {table}_marks_day ON {table}")
        op.execute("DROP FUNCTION mark_day()")
    op.drop_table("day_mark")
    op.drop_table("day_sum")


def make_triggers(*tables: str) -> None:
    """Let changes of these tables mark their days; of all, if none is named. The function is made with all of them."""
    is_sqlite = op.get_bind().dialect.name == "sqlite"
    if not is_sqlite and not tables:
        op.execute(POSTGRES_FUNCTION)
    for table in tables or WATCHED:
        changes = f"UPDATE OF {', '.join(WATCHED[table])}"
        if not is_sqlite:
            op.execute(
                f"CREATE TRIGGER {table}_marks_day AFTER INSERT OR DELETE OR {changes} ON {table} "
                "FOR EACH ROW EXECUTE FUNCTION mark_day()"
            )
            continue
        new, old = (SQLITE_MARK.format(row=row, and_condition="") for row in ("NEW", "OLD"))
        left = SQLITE_MARK.format(row="OLD", and_condition=f" AND {HAS_MOVED}")
        for event, on, body in (("insert", "INSERT", new), ("update", changes, new + left), ("delete", "DELETE", old)):
            op.execute(f"CREATE TRIGGER {table}_marks_day_{event} AFTER {on} ON {table} BEGIN {body} END")
