"""studies' protocols, roles, review, leftovers, diary, calibrations, privacy, webhooks

New columns keep their server defaults, so that a process of the version before can still write beside a newer one.

Revision ID: 20261121_people_review
Revises: 20261121_food_table
Create Date: 2026-11-21 17:40:00
"""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "20261121_people_review"
down_revision = "20261121_food_table"
branch_labels = None
depends_on = None

INSTANT = sa.DateTime(timezone=True)
JSON_VALUE = sa.JSON(none_as_null=True).with_variant(postgresql.JSONB(none_as_null=True), "postgresql")
BIG_ID = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    connection = op.get_bind()
    create_tables()
    make_append_only(connection)
    alter_people(connection)
    alter_meals(connection)
    alter_jobs_and_runs()
    alter_items()
    alter_records()
    for table, column in REFERENCES:
        op.create_index(op.f(f"ix_{table}_{column}"), table, [column])


def downgrade() -> None:
    """What people said about meals is lost, after-meal pairs, days and meals without photographs too."""
    connection = op.get_bind()
    for table, column in REFERENCES:
        op.drop_index(op.f(f"ix_{table}_{column}"), table)
    fit_into_older_tables()
    restore_older_tables()
    for table in reversed(NEW_TABLES):
        op.drop_table(table)
    if connection.dialect.name == "postgresql":
        op.execute("DROP FUNCTION refuse_change()")


REFERENCES = (  # without an index each row that is erased makes the database read the whole table that refers to it
    ("meal", "device_id"), ("job", "event_id"), ("item", "parent_id"), ("item", "event_id"), ("item_food", "event_id"),
    ("item_measure", "event_id"), ("leftover", "event_id"), ("meal_event", "device_id"),
)  # fmt: skip
NEW_TABLES = (
    "audit_event", "erasure_receipt", "study_member", "tombstone", "webhook", "blob_deletion", "day_event",
    "diary_day", "camera_calibration", "meal_event", "webhook_delivery", "item_measure", "leftover",
)  # fmt: skip
EVENT_KINDS = (
    "confirm", "reject", "set_food", "set_volume", "set_mass", "set_share", "set_leftover", "add", "declare", "split",
    "merge", "redraw", "nothing_left", "confirm_meal", "comment", "question", "answer", "undo",
)  # fmt: skip
LAYERS = ("automatic", "participant", "reviewer")
PURPOSES = ("meal", "after", "remeasure")
ORIGINS = ("pipeline", "after", "declared", "added", "split", "merged")
APPEND_ONLY_SQLITE = """
    CREATE TRIGGER audit_event_no_{lower} BEFORE {verb} ON audit_event
    BEGIN SELECT RAISE(ABORT, 'audit_event is append-only'); END
"""
# INSERT OR REPLACE fires no DELETE trigger unless its connection asks for it (recursive_triggers)
NO_REPLACE_SQLITE = """
    CREATE TRIGGER audit_event_no_replace BEFORE INSERT ON audit_event
    WHEN EXISTS (SELECT 1 FROM audit_event WHERE id = NEW.id)
    BEGIN SELECT RAISE(ABORT, 'audit_event is append-only'); END
"""
APPEND_ONLY_POSTGRES = (
    (
        "CREATE FUNCTION refuse_change() RETURNS trigger LANGUAGE plpgsql AS "
        "$$ BEGIN RAISE EXCEPTION '% is append-only', TG_TABLE_NAME; END $$"
    ),
    (
        "CREATE TRIGGER audit_event_no_change BEFORE UPDATE OR DELETE OR TRUNCATE ON audit_event "
        "FOR EACH STATEMENT EXECUTE FUNCTION refuse_change()"
    ),
)
NEW_ALIASES = {
    "sqlite": "UPDATE {table} SET alias = lower(hex(randomblob(16)))",
    "postgresql": "UPDATE {table} SET alias = gen_random_uuid()",
}
CONSUMED = """
    UPDATE effective_record SET consumed_g = edible_g,
        consumed_low_g = mass_low_g * edible_g / mass_g, consumed_high_g = mass_high_g * edible_g / mass_g
    WHERE mass_g > 0
"""
# In the order of their references. What a person told has no place in the older tables.
LOST = (
    "DELETE FROM item_food WHERE layer <> 'automatic' OR item_id IN (SELECT id FROM item WHERE origin <> 'pipeline')",
    "DELETE FROM item_candidate WHERE item_id IN (SELECT id FROM item WHERE origin <> 'pipeline')",
    "DELETE FROM effective_record WHERE item_id IN (SELECT id FROM item WHERE origin <> 'pipeline')",
    "DELETE FROM leftover",
    "DELETE FROM item_measure",
    "UPDATE item SET parent_id = NULL",
    "DELETE FROM item WHERE origin <> 'pipeline'",
    "DELETE FROM run_artefact WHERE run_id IN (SELECT id FROM run WHERE purpose <> 'meal')",
    "DELETE FROM run WHERE purpose <> 'meal'",
    "DELETE FROM job WHERE purpose <> 'meal'",
    "DELETE FROM meal_image WHERE slot IN ('after_left', 'after_right')",
    "DELETE FROM webhook_delivery",
    "DELETE FROM meal_event",
    "DELETE FROM meal WHERE origin = 'declared'",
    "DELETE FROM access_token WHERE kind = 'session'",
    "UPDATE study SET location_policy = 'drop', location_decimals = NULL WHERE location_policy = 'round'",
)


def one_of(column: str, values: tuple[str, ...]) -> str:
    return f"{column} IN ({', '.join(repr(value) for value in values)})"


def make_append_only(connection: sa.Connection) -> None:
    """The audit log: the database itself refuses to change or delete what is written."""
    if connection.dialect.name == "postgresql":
        statements = list(APPEND_ONLY_POSTGRES)
    else:
        statements = [APPEND_ONLY_SQLITE.format(verb=verb, lower=verb.lower()) for verb in ("UPDATE", "DELETE")]
        statements.append(NO_REPLACE_SQLITE)
    for statement in statements:
        op.execute(statement)


def alter_people(connection: sa.Connection) -> None:
    with op.batch_alter_table("study") as batch_op:
        batch_op.add_column(sa.Column("camera", JSON_VALUE, nullable=True))
        batch_op.add_column(sa.Column("expects_after_pair", sa.Boolean(), nullable=False, server_default=sa.false()))
        batch_op.add_column(sa.Column("after_window_minutes", sa.Integer(), nullable=False, server_default="240"))
        batch_op.add_column(sa.Column("location_decimals", sa.Integer(), nullable=True))
        batch_op.add_column(sa.Column("retention_days", sa.Integer(), nullable=True))
        batch_op.add_column(
            sa.Column("withdrawal_policy", sa.String(length=16), nullable=False, server_default="erase")
        )
        batch_op.add_column(sa.Column("locale", sa.String(length=8), nullable=False, server_default="en"))
        batch_op.add_column(sa.Column("gives_feedback", sa.Boolean(), nullable=False, server_default=sa.false()))
        batch_op.add_column(sa.Column("day_starts_minutes", sa.Integer(), nullable=False, server_default="0"))
        batch_op.add_column(sa.Column("version", sa.Integer(), nullable=False, server_default="1"))
        batch_op.drop_constraint(op.f("ck_study_location_policy"), type_="check")
        for column, values in (
            ("location_policy", ("drop", "round", "keep")),
            ("withdrawal_policy", ("keep", "anonymise", "erase")),
            ("locale", ("en", "de", "es", "zh")),
        ):
            batch_op.create_check_constraint(op.f(f"ck_study_{column}"), one_of(column, values))
        batch_op.create_check_constraint(
            op.f("ck_study_decimals_to_round"), "(location_policy = 'round') = (location_decimals IS NOT NULL)"
        )
    with op.batch_alter_table("participant") as batch_op:
        batch_op.add_column(sa.Column("alias", sa.Uuid(), nullable=True))
        batch_op.add_column(sa.Column("starts_on", sa.Date(), nullable=True))
        batch_op.add_column(sa.Column("profile", JSON_VALUE, nullable=True))
        batch_op.add_column(sa.Column("withdrawn_at", INSTANT, nullable=True))
    with op.batch_alter_table("device") as batch_op:
        batch_op.add_column(sa.Column("model", sa.String(length=200), nullable=True))
        batch_op.add_column(sa.Column("app_version", sa.String(length=64), nullable=True))
        batch_op.add_column(sa.Column("clock_skew_seconds", sa.Double(), nullable=True))
        batch_op.add_column(sa.Column("last_used_at", INSTANT, nullable=True))
        batch_op.add_column(sa.Column("revoked_at", INSTANT, nullable=True))
    with op.batch_alter_table("staff") as batch_op:
        batch_op.add_column(sa.Column("password_hash", sa.String(length=200), nullable=True))
        batch_op.add_column(sa.Column("disabled_at", INSTANT, nullable=True))
    with op.batch_alter_table("access_token") as batch_op:
        batch_op.add_column(sa.Column("kind", sa.String(length=16), nullable=False, server_default="device"))
        batch_op.add_column(sa.Column("name", sa.String(length=200), nullable=True))
        batch_op.add_column(sa.Column("scope", sa.String(length=16), nullable=False, server_default="write"))
        batch_op.add_column(sa.Column("study_id", sa.Uuid(), nullable=True))
        batch_op.add_column(sa.Column("last_used_at", INSTANT, nullable=True))
        batch_op.create_foreign_key(op.f("fk_access_token_study_id_study"), "study", ["study_id"], ["id"])
        batch_op.create_check_constraint(
            op.f("ck_access_token_kind"), one_of("kind", ("device", "session", "personal"))
        )
        batch_op.create_check_constraint(op.f("ck_access_token_scope"), one_of("scope", ("read", "write")))
    op.execute("UPDATE access_token SET kind = 'personal' WHERE staff_id IS NOT NULL")
    give_aliases(connection, "participant")


def alter_meals(connection: sa.Connection) -> None:
    with op.batch_alter_table("meal") as batch_op:
        batch_op.add_column(sa.Column("alias", sa.Uuid(), nullable=True))
        batch_op.add_column(sa.Column("origin", sa.String(length=16), nullable=False, server_default="photographed"))
        batch_op.add_column(sa.Column("after_status", sa.String(length=16), nullable=True))
        batch_op.add_column(sa.Column("after_details", JSON_VALUE, nullable=True))
        batch_op.add_column(sa.Column("after_failure_code", sa.String(length=64), nullable=True))
        batch_op.add_column(sa.Column("after_failure_message", sa.Text(), nullable=True))
        batch_op.add_column(sa.Column("after_failure_advice", sa.Text(), nullable=True))
        batch_op.add_column(sa.Column("after_due_at", INSTANT, nullable=True))
        batch_op.drop_column("deleted_at")  # nothing ever set it: a meal that is deleted is not there
        batch_op.create_index(op.f("ix_meal_after_due_at"), ["after_due_at"])
        batch_op.create_index(op.f("ix_meal_after_status"), ["after_status"])
        batch_op.create_index(op.f("ix_meal_participant_id_local_date"), ["participant_id", "local_date"])
        batch_op.create_check_constraint(op.f("ck_meal_origin"), one_of("origin", ("photographed", "declared")))
        batch_op.create_check_constraint(
            op.f("ck_meal_after_status"),
            one_of(
                "after_status",
                ("receiving", "queued", "processing", "estimated", "needs_review", "failed", "nothing_left"),
            ),
        )
    give_aliases(connection, "meal")
    with op.batch_alter_table("meal_image") as batch_op:
        batch_op.add_column(sa.Column("erased_at", INSTANT, nullable=True))
        batch_op.drop_constraint(op.f("ck_meal_image_slot"), type_="check")
        batch_op.create_check_constraint(
            op.f("ck_meal_image_slot"), one_of("slot", ("left", "right", "after_left", "after_right"))
        )


def give_aliases(connection: sa.Connection, table: str) -> None:
    op.execute(NEW_ALIASES[connection.dialect.name].format(table=table))
    with op.batch_alter_table(table) as batch_op:
        batch_op.alter_column("alias", existing_type=sa.Uuid(), nullable=False)
        batch_op.create_unique_constraint(op.f(f"uq_{table}_alias"), ["alias"])


def alter_jobs_and_runs() -> None:
    with op.batch_alter_table("job") as batch_op:
        batch_op.add_column(sa.Column("purpose", sa.String(length=16), nullable=False, server_default="meal"))
        batch_op.add_column(sa.Column("event_id", sa.Uuid(), nullable=True))
        batch_op.create_foreign_key(op.f("fk_job_event_id_meal_event"), "meal_event", ["event_id"], ["id"])
        batch_op.create_check_constraint(op.f("ck_job_purpose"), one_of("purpose", PURPOSES))
    with op.batch_alter_table("run") as batch_op:
        batch_op.add_column(sa.Column("purpose", sa.String(length=16), nullable=False, server_default="meal"))
        batch_op.create_check_constraint(op.f("ck_run_purpose"), one_of("purpose", PURPOSES))


def alter_items() -> None:
    with op.batch_alter_table("item") as batch_op:
        batch_op.add_column(sa.Column("meal_id", sa.Uuid(), nullable=True))
        batch_op.add_column(sa.Column("origin", sa.String(length=16), nullable=False, server_default="pipeline"))
        batch_op.add_column(sa.Column("parent_id", sa.Uuid(), nullable=True))
        batch_op.add_column(sa.Column("event_id", sa.Uuid(), nullable=True))
        batch_op.add_column(sa.Column("traits", JSON_VALUE, nullable=False, server_default="{}"))
    op.execute("UPDATE item SET meal_id = (SELECT run.meal_id FROM run WHERE run.id = item.run_id)")
    with op.batch_alter_table("item") as batch_op:
        batch_op.alter_column("meal_id", existing_type=sa.Uuid(), nullable=False)
        batch_op.alter_column("run_id", existing_type=sa.Uuid(), nullable=True)
        batch_op.create_index(op.f("ix_item_meal_id"), ["meal_id"])
        batch_op.create_foreign_key(op.f("fk_item_event_id_meal_event"), "meal_event", ["event_id"], ["id"])
        batch_op.create_foreign_key(op.f("fk_item_meal_id_meal"), "meal", ["meal_id"], ["id"])
        batch_op.create_foreign_key(op.f("fk_item_parent_id_item"), "item", ["parent_id"], ["id"])
        batch_op.create_check_constraint(op.f("ck_item_origin"), one_of("origin", ORIGINS))
        batch_op.create_check_constraint(
            op.f("ck_item_run_of_what_it_found"), "(run_id IS NULL) = (origin NOT IN ('pipeline', 'after'))"
        )
    with op.batch_alter_table("item_food") as batch_op:
        batch_op.add_column(sa.Column("layer", sa.String(length=16), nullable=False, server_default="automatic"))
        batch_op.add_column(sa.Column("event_id", sa.Uuid(), nullable=True))
        batch_op.create_foreign_key(op.f("fk_item_food_event_id_meal_event"), "meal_event", ["event_id"], ["id"])
        batch_op.create_check_constraint(op.f("ck_item_food_layer"), one_of("layer", LAYERS))


def alter_records() -> None:
    with op.batch_alter_table("effective_record") as batch_op:
        batch_op.add_column(sa.Column("origin", sa.String(length=16), nullable=False, server_default="pipeline"))
        batch_op.add_column(sa.Column("provisional", sa.Boolean(), nullable=False, server_default=sa.false()))
        batch_op.add_column(sa.Column("reviewed", sa.Boolean(), nullable=False, server_default=sa.false()))
        batch_op.add_column(sa.Column("share", sa.Double(), nullable=False, server_default="1"))
        for column in ("left_g", "consumed_g", "consumed_low_g", "consumed_high_g"):
            batch_op.add_column(sa.Column(column, sa.Double(), nullable=True))
        batch_op.add_column(sa.Column("flags", JSON_VALUE, nullable=False, server_default="[]"))
        batch_op.add_column(sa.Column("doubt", sa.Double(), nullable=False, server_default="0"))
        batch_op.create_check_constraint(op.f("ck_effective_record_origin"), one_of("origin", ORIGINS))
        batch_op.create_index(op.f("ix_effective_record_participant_id_local_date"), ["participant_id", "local_date"])
        batch_op.create_index(
            op.f("ix_effective_record_study_id_reviewed_doubt_item_id"), ["study_id", "reviewed", "doubt", "item_id"]
        )
    op.execute(CONSUMED)


def fit_into_older_tables() -> None:
    for statement in LOST:
        op.execute(statement)


def restore_older_tables() -> None:
    with op.batch_alter_table("effective_record") as batch_op:
        batch_op.drop_index(op.f("ix_effective_record_study_id_reviewed_doubt_item_id"))
        batch_op.drop_index(op.f("ix_effective_record_participant_id_local_date"))
        batch_op.drop_constraint(op.f("ck_effective_record_origin"), type_="check")
        for column in (
            "origin", "provisional", "reviewed", "share", "left_g", "consumed_g", "consumed_low_g", "consumed_high_g",
            "flags", "doubt",
        ):  # fmt: skip
            batch_op.drop_column(column)
    with op.batch_alter_table("item_food") as batch_op:
        batch_op.drop_constraint(op.f("ck_item_food_layer"), type_="check")
        batch_op.drop_constraint(op.f("fk_item_food_event_id_meal_event"), type_="foreignkey")
        batch_op.drop_column("layer")
        batch_op.drop_column("event_id")
    with op.batch_alter_table("item") as batch_op:
        batch_op.drop_index(op.f("ix_item_meal_id"))
        for name in ("ck_item_origin", "ck_item_run_of_what_it_found"):
            batch_op.drop_constraint(op.f(name), type_="check")
        for name in ("fk_item_event_id_meal_event", "fk_item_meal_id_meal", "fk_item_parent_id_item"):
            batch_op.drop_constraint(op.f(name), type_="foreignkey")
        batch_op.alter_column("run_id", existing_type=sa.Uuid(), nullable=False)
        for column in ("meal_id", "origin", "parent_id", "event_id", "traits"):
            batch_op.drop_column(column)
    with op.batch_alter_table("run") as batch_op:
        batch_op.drop_constraint(op.f("ck_run_purpose"), type_="check")
        batch_op.drop_column("purpose")
    with op.batch_alter_table("job") as batch_op:
        batch_op.drop_constraint(op.f("ck_job_purpose"), type_="check")
        batch_op.drop_constraint(op.f("fk_job_event_id_meal_event"), type_="foreignkey")
        batch_op.drop_column("purpose")
        batch_op.drop_column("event_id")
    with op.batch_alter_table("meal_image") as batch_op:
        batch_op.drop_constraint(op.f("ck_meal_image_slot"), type_="check")
        batch_op.drop_column("erased_at")
        batch_op.create_check_constraint(op.f("ck_meal_image_slot"), one_of("slot", ("left", "right")))
    with op.batch_alter_table("meal") as batch_op:
        batch_op.add_column(sa.Column("deleted_at", INSTANT, nullable=True))
        batch_op.drop_index(op.f("ix_meal_after_due_at"))
        batch_op.drop_index(op.f("ix_meal_after_status"))
        batch_op.drop_index(op.f("ix_meal_participant_id_local_date"))
        batch_op.drop_constraint(op.f("uq_meal_alias"), type_="unique")
        for name in ("ck_meal_origin", "ck_meal_after_status"):
            batch_op.drop_constraint(op.f(name), type_="check")
        for column in (
            "alias", "origin", "after_status", "after_details", "after_failure_code", "after_failure_message",
            "after_failure_advice", "after_due_at",
        ):  # fmt: skip
            batch_op.drop_column(column)
    restore_older_people()


def restore_older_people() -> None:
    with op.batch_alter_table("access_token") as batch_op:
        for name in ("ck_access_token_kind", "ck_access_token_scope"):
            batch_op.drop_constraint(op.f(name), type_="check")
        batch_op.drop_constraint(op.f("fk_access_token_study_id_study"), type_="foreignkey")
        for column in ("kind", "name", "scope", "study_id", "last_used_at"):
            batch_op.drop_column(column)
    with op.batch_alter_table("staff") as batch_op:
        batch_op.drop_column("password_hash")
        batch_op.drop_column("disabled_at")
    with op.batch_alter_table("device") as batch_op:
        for column in ("model", "app_version", "clock_skew_seconds", "last_used_at", "revoked_at"):
            batch_op.drop_column(column)
    with op.batch_alter_table("participant") as batch_op:
        batch_op.drop_constraint(op.f("uq_participant_alias"), type_="unique")
        for column in ("alias", "starts_on", "profile", "withdrawn_at"):
            batch_op.drop_column(column)
    with op.batch_alter_table("study") as batch_op:
        for name in ("location_policy", "withdrawal_policy", "locale", "decimals_to_round"):
            batch_op.drop_constraint(op.f(f"ck_study_{name}"), type_="check")
        for column in (
            "camera", "expects_after_pair", "after_window_minutes", "location_decimals", "retention_days",
            "withdrawal_policy", "locale", "gives_feedback", "day_starts_minutes", "version",
        ):  # fmt: skip
            batch_op.drop_column(column)
        batch_op.create_check_constraint(op.f("ck_study_location_policy"), one_of("location_policy", ("drop", "keep")))


def create_tables() -> None:
    op.create_table(
        "audit_event",
        sa.Column("id", BIG_ID, nullable=False),
        sa.Column("at", INSTANT, nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=True),
        sa.Column("actor_kind", sa.String(length=16), nullable=False),
        sa.Column("actor", sa.String(length=200), nullable=False),
        sa.Column("action", sa.String(length=64), nullable=False),
        sa.Column("subject", sa.String(length=200), nullable=True),
        sa.Column("details", JSON_VALUE, nullable=False),
        sa.Column("request_id", sa.String(length=32), nullable=True),
        sa.CheckConstraint("actor_kind IN ('staff', 'device', 'system')", name=op.f("ck_audit_event_actor_kind")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_audit_event")),
    )
    op.create_index(op.f("ix_audit_event_study_id_id"), "audit_event", ["study_id", "id"])

    op.create_table(
        "erasure_receipt",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("what", sa.String(length=16), nullable=False),
        sa.Column("policy", sa.String(length=16), nullable=False),
        sa.Column("counts", JSON_VALUE, nullable=False),
        sa.Column("erased_at", INSTANT, nullable=False),
        sa.CheckConstraint("what IN ('participant', 'meal', 'photographs')", name=op.f("ck_erasure_receipt_what")),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_erasure_receipt_study_id_study")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_erasure_receipt")),
    )
    op.create_index(op.f("ix_erasure_receipt_study_id"), "erasure_receipt", ["study_id"])

    op.create_table(
        "study_member",
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("staff_id", sa.Uuid(), nullable=False),
        sa.Column("role", sa.String(length=16), nullable=False),
        sa.Column("created_at", INSTANT, nullable=False),
        sa.CheckConstraint("role IN ('viewer', 'reviewer', 'owner')", name=op.f("ck_study_member_role")),
        sa.ForeignKeyConstraint(["staff_id"], ["staff.id"], name=op.f("fk_study_member_staff_id_staff")),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_study_member_study_id_study")),
        sa.PrimaryKeyConstraint("study_id", "staff_id", name=op.f("pk_study_member")),
    )
    op.create_index(op.f("ix_study_member_staff_id"), "study_member", ["staff_id"])

    op.create_table(
        "tombstone",
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=True),
        sa.Column("change_seq", sa.BigInteger(), nullable=True),
        sa.Column("erased_at", INSTANT, nullable=False),
        sa.CheckConstraint("kind IN ('participant', 'meal', 'token', 'record', 'day')", name=op.f("ck_tombstone_kind")),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_tombstone_study_id_study")),
        sa.PrimaryKeyConstraint("kind", "digest", name=op.f("pk_tombstone")),
    )
    op.create_index(op.f("ix_tombstone_study_id_change_seq"), "tombstone", ["study_id", "change_seq"])

    op.create_table(
        "webhook",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("url", sa.String(length=500), nullable=False),
        sa.Column("events", JSON_VALUE, nullable=False),
        sa.Column("secret_sealed", sa.String(length=300), nullable=False),
        sa.Column("author", sa.String(length=200), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("created_at", INSTANT, nullable=False),
        sa.Column("disabled_at", INSTANT, nullable=True),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_webhook_study_id_study")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_webhook")),
    )
    op.create_index(op.f("ix_webhook_study_id"), "webhook", ["study_id"])

    op.create_table(
        "blob_deletion",
        sa.Column("blob_key", sa.String(length=300), nullable=False),
        sa.Column("receipt_id", sa.Uuid(), nullable=True),
        sa.Column("requested_at", INSTANT, nullable=False),
        sa.ForeignKeyConstraint(
            ["receipt_id"], ["erasure_receipt.id"], name=op.f("fk_blob_deletion_receipt_id_erasure_receipt")
        ),
        sa.PrimaryKeyConstraint("blob_key", name=op.f("pk_blob_deletion")),
    )
    op.create_table(
        "day_event",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("participant_id", sa.Uuid(), nullable=False),
        sa.Column("local_date", sa.Date(), nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("layer", sa.String(length=16), nullable=False),
        sa.Column("author", sa.String(length=200), nullable=False),
        sa.Column("created_at", INSTANT, nullable=False),
        sa.CheckConstraint("kind IN ('closed', 'ate_nothing', 'reopened')", name=op.f("ck_day_event_kind")),
        sa.CheckConstraint("layer IN ('automatic', 'participant', 'reviewer')", name=op.f("ck_day_event_layer")),
        sa.ForeignKeyConstraint(
            ["participant_id"], ["participant.id"], name=op.f("fk_day_event_participant_id_participant")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_day_event")),
    )
    op.create_index(op.f("ix_day_event_participant_id_local_date"), "day_event", ["participant_id", "local_date"])

    op.create_table(
        "diary_day",
        sa.Column("participant_id", sa.Uuid(), nullable=False),
        sa.Column("local_date", sa.Date(), nullable=False),
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("status", sa.String(length=16), nullable=False),
        sa.Column("ate_nothing", sa.Boolean(), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("changed_at", INSTANT, nullable=False),
        sa.Column("change_seq", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("status IN ('open', 'closed')", name=op.f("ck_diary_day_status")),
        sa.ForeignKeyConstraint(
            ["participant_id"], ["participant.id"], name=op.f("fk_diary_day_participant_id_participant")
        ),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_diary_day_study_id_study")),
        sa.PrimaryKeyConstraint("participant_id", "local_date", name=op.f("pk_diary_day")),
        sa.UniqueConstraint("id", name=op.f("uq_diary_day_id")),
    )
    op.create_index(op.f("ix_diary_day_study_id_local_date"), "diary_day", ["study_id", "local_date"])
    op.create_index(op.f("ix_diary_day_study_id_change_seq"), "diary_day", ["study_id", "change_seq"])

    op.create_table(
        "camera_calibration",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("device_id", sa.Uuid(), nullable=True),
        sa.Column("model", sa.String(length=200), nullable=True),
        sa.Column("marker", sa.String(length=64), nullable=False),
        sa.Column("camera", JSON_VALUE, nullable=False),
        sa.Column("rms_px", sa.Double(), nullable=False),
        sa.Column("photographs", sa.Integer(), nullable=False),
        sa.Column("author", sa.String(length=200), nullable=False),
        sa.Column("created_at", INSTANT, nullable=False),
        sa.Column("withdrawn_at", INSTANT, nullable=True),
        sa.ForeignKeyConstraint(["device_id"], ["device.id"], name=op.f("fk_camera_calibration_device_id_device")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_camera_calibration")),
    )
    op.create_index(op.f("ix_camera_calibration_device_id"), "camera_calibration", ["device_id"])
    op.create_index(op.f("ix_camera_calibration_model"), "camera_calibration", ["model"])

    op.create_table(
        "meal_event",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("meal_id", sa.Uuid(), nullable=False),
        sa.Column("sequence", sa.Integer(), nullable=False),
        sa.Column("item_id", sa.Uuid(), nullable=True),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("layer", sa.String(length=16), nullable=False),
        sa.Column("device_id", sa.Uuid(), nullable=True),
        sa.Column("staff_id", sa.Uuid(), nullable=True),
        sa.Column("old", JSON_VALUE, nullable=False),
        sa.Column("new", JSON_VALUE, nullable=False),
        sa.Column("request_sha256", sa.String(length=64), nullable=False),
        sa.Column("created_at", INSTANT, nullable=False),
        sa.CheckConstraint(one_of("kind", EVENT_KINDS), name=op.f("ck_meal_event_kind")),
        sa.CheckConstraint("layer IN ('automatic', 'participant', 'reviewer')", name=op.f("ck_meal_event_layer")),
        sa.ForeignKeyConstraint(["device_id"], ["device.id"], name=op.f("fk_meal_event_device_id_device")),
        sa.ForeignKeyConstraint(["meal_id"], ["meal.id"], name=op.f("fk_meal_event_meal_id_meal")),
        sa.ForeignKeyConstraint(["staff_id"], ["staff.id"], name=op.f("fk_meal_event_staff_id_staff")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_meal_event")),
        sa.UniqueConstraint("meal_id", "sequence", name=op.f("uq_meal_event_meal_id_sequence")),
    )
    op.create_index(op.f("ix_meal_event_item_id"), "meal_event", ["item_id"])

    op.create_table(
        "webhook_delivery",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("webhook_id", sa.Uuid(), nullable=False),
        sa.Column("event", sa.String(length=64), nullable=False),
        sa.Column("payload", JSON_VALUE, nullable=False),
        sa.Column("meal_id", sa.Uuid(), nullable=True),
        sa.Column("participant_id", sa.Uuid(), nullable=True),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("next_try_at", INSTANT, nullable=True),
        sa.Column("last_status", sa.Integer(), nullable=True),
        sa.Column("last_error", sa.String(length=200), nullable=True),
        sa.Column("created_at", INSTANT, nullable=False),
        sa.Column("delivered_at", INSTANT, nullable=True),
        sa.CheckConstraint("state IN ('waiting', 'delivered', 'given_up')", name=op.f("ck_webhook_delivery_state")),
        sa.ForeignKeyConstraint(["meal_id"], ["meal.id"], name=op.f("fk_webhook_delivery_meal_id_meal")),
        sa.ForeignKeyConstraint(
            ["participant_id"], ["participant.id"], name=op.f("fk_webhook_delivery_participant_id_participant")
        ),
        sa.ForeignKeyConstraint(["webhook_id"], ["webhook.id"], name=op.f("fk_webhook_delivery_webhook_id_webhook")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_webhook_delivery")),
    )
    op.create_index(op.f("ix_webhook_delivery_meal_id"), "webhook_delivery", ["meal_id"])
    op.create_index(op.f("ix_webhook_delivery_participant_id"), "webhook_delivery", ["participant_id"])
    op.create_index(op.f("ix_webhook_delivery_state_next_try_at"), "webhook_delivery", ["state", "next_try_at"])
    op.create_index(op.f("ix_webhook_delivery_webhook_id_created_at"), "webhook_delivery", ["webhook_id", "created_at"])

    op.create_table(
        "item_measure",
        sa.Column("item_id", sa.Uuid(), nullable=False),
        sa.Column("event_id", sa.Uuid(), nullable=False),
        sa.Column("run_id", sa.Uuid(), nullable=False),
        sa.Column("rings", JSON_VALUE, nullable=False),
        sa.Column("volume_ml", sa.Double(), nullable=True),
        sa.Column("volume_low_ml", sa.Double(), nullable=True),
        sa.Column("volume_high_ml", sa.Double(), nullable=True),
        sa.Column("relative_sd", JSON_VALUE, nullable=False),
        sa.Column("flags", JSON_VALUE, nullable=False),
        sa.ForeignKeyConstraint(["event_id"], ["meal_event.id"], name=op.f("fk_item_measure_event_id_meal_event")),
        sa.ForeignKeyConstraint(["item_id"], ["item.id"], name=op.f("fk_item_measure_item_id_item")),
        sa.ForeignKeyConstraint(["run_id"], ["run.id"], name=op.f("fk_item_measure_run_id_run")),
        sa.PrimaryKeyConstraint("item_id", "event_id", name=op.f("pk_item_measure")),
    )
    op.create_index(op.f("ix_item_measure_run_id"), "item_measure", ["run_id"])

    op.create_table(
        "leftover",
        sa.Column("after_item_id", sa.Uuid(), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("item_id", sa.Uuid(), nullable=True),
        sa.Column("leftover_class", sa.String(length=16), nullable=False),
        sa.Column("layer", sa.String(length=16), nullable=False),
        sa.Column("event_id", sa.Uuid(), nullable=True),
        sa.Column("flags", JSON_VALUE, nullable=False),
        sa.Column("created_at", INSTANT, nullable=False),
        sa.CheckConstraint(
            "(item_id IS NULL) = (leftover_class = 'unmatched')", name=op.f("ck_leftover_matched_to_an_item")
        ),
        sa.CheckConstraint("layer IN ('automatic', 'participant', 'reviewer')", name=op.f("ck_leftover_layer")),
        sa.CheckConstraint(
            "leftover_class IN ('food_left', 'refuse', 'unmatched')", name=op.f("ck_leftover_leftover_class")
        ),
        sa.ForeignKeyConstraint(["after_item_id"], ["item.id"], name=op.f("fk_leftover_after_item_id_item")),
        sa.ForeignKeyConstraint(["event_id"], ["meal_event.id"], name=op.f("fk_leftover_event_id_meal_event")),
        sa.ForeignKeyConstraint(["item_id"], ["item.id"], name=op.f("fk_leftover_item_id_item")),
        sa.PrimaryKeyConstraint("after_item_id", "version", name=op.f("pk_leftover")),
    )
    op.create_index(op.f("ix_leftover_item_id"), "leftover", ["item_id"])
