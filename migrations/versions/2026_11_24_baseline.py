"""all tables

The first migration of version 0.4. Databases of 0.1 to 0.3, which nobody runs, are not brought up to date.

Revision ID: 20261124_baseline
Revises:
Create Date: 2026-11-24 00:00:00
"""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

from app.db.migrate import create_triggers, drop_triggers

revision = "20261124_baseline"
down_revision = None
branch_labels = None
depends_on = None

BIG_ID = sa.BigInteger().with_variant(
    sa.Integer(), "sqlite"
)  # the only type that SQLite counts up by itself
JSON = sa.JSON(none_as_null=True).with_variant(postgresql.JSONB(none_as_null=True), "postgresql")
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
TABLES = (  # in the order of their references
    "audit_event",
    "component",
    "day_mark",
    "food_release",
    "food_word",
    "recompute",
    "spent_key",
    "staff",
    "study",
    "study_day_mark",
    "worker_lease",
    "erasure_receipt",
    "export",
    "food",
    "food_activation",
    "food_word_trigram",
    "participant",
    "release",
    "spent_code",
    "study_day_sum",
    "study_density",
    "study_member",
    "study_vessel",
    "tombstone",
    "webhook",
    "blob_deletion",
    "day_event",
    "day_sum",
    "device",
    "diary_day",
    "enrolment",
    "food_change",
    "food_code",
    "food_density",
    "food_ingredient",
    "food_nutrient",
    "food_portion",
    "food_posting",
    "release_change",
    "release_file",
    "study_vessel_version",
    "access_token",
    "camera_calibration",
    "meal",
    "meal_event",
    "meal_image",
    "webhook_delivery",
    "job",
    "remeasurement",
    "run",
    "item",
    "run_artefact",
    "effective_record",
    "index_entry",
    "item_candidate",
    "item_food",
    "item_identification",
    "item_measure",
    "leftover",
    "remeasured_pair",
    "remeasured_item",
)


def upgrade() -> None:  # noqa: PLR0915  # one statement per table and index
    op.create_table(
        "audit_event",
        sa.Column("id", BIG_ID, nullable=False),
        sa.Column("at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=True),
        sa.Column("actor_kind", sa.String(length=16), nullable=False),
        sa.Column("actor", sa.String(length=200), nullable=False),
        sa.Column("action", sa.String(length=64), nullable=False),
        sa.Column("subject", sa.String(length=200), nullable=True),
        sa.Column("details", JSON, nullable=False),
        sa.Column("request_id", sa.String(length=32), nullable=True),
        sa.CheckConstraint(
            "actor_kind IN ('staff', 'device', 'system')", name=op.f("ck_audit_event_actor_kind")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_audit_event")),
    )
    op.create_index(
        op.f("ix_audit_event_study_id_id"), "audit_event", ["study_id", "id"], unique=False
    )
    op.create_index(
        "ix_audit_event_last_backup",
        "audit_event",
        ["id"],
        unique=False,
        sqlite_where=sa.text("action = 'backup.make'"),
        postgresql_where=sa.text("action = 'backup.make'"),
    )
    op.create_table(
        "component",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("number", sa.String(length=16), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("unit", sa.String(length=8), nullable=False),
        sa.Column("tagname", sa.String(length=16), nullable=True),
        sa.Column("expression", sa.String(length=100), nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_component")),
        sa.UniqueConstraint("number", name=op.f("uq_component_number")),
    )
    op.create_table(
        "day_mark",
        sa.Column("id", BIG_ID, autoincrement=True, nullable=False),
        sa.Column("participant_id", sa.Uuid(), nullable=False),
        sa.Column("local_date", sa.Date(), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_day_mark")),
    )
    op.create_index(
        op.f("ix_day_mark_participant_id_local_date"),
        "day_mark",
        ["participant_id", "local_date"],
        unique=False,
    )
    op.create_index(
        op.f("ix_day_mark_study_id_local_date_participant_id"),
        "day_mark",
        ["study_id", "local_date", "participant_id"],
        unique=False,
    )
    op.create_table(
        "food_release",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("source", sa.String(length=32), nullable=False),
        sa.Column("name", sa.String(length=100), nullable=False),
        sa.Column("version", sa.String(length=32), nullable=False),
        sa.Column("released_on", sa.Date(), nullable=False),
        sa.Column("checksum", sa.String(length=64), nullable=False),
        sa.Column("imported_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("importer_id", sa.Uuid(), nullable=True),
        sa.Column("written_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("completed_at", sa.DateTime(timezone=True), nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_food_release")),
        sa.UniqueConstraint("checksum", name=op.f("uq_food_release_checksum")),
    )
    op.create_table(
        "food_word",
        sa.Column(
            "word",
            sa.String(length=64).with_variant(sa.String(length=64, collation="C"), "postgresql"),
            nullable=False,
        ),
        sa.PrimaryKeyConstraint("word", name=op.f("pk_food_word")),
    )
    op.create_table(
        "recompute",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("author", sa.String(length=200), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("food_releases", JSON, nullable=False),
        sa.Column("started_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_recompute")),
    )
    op.create_table(
        "spent_key",
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("spent_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("digest", name=op.f("pk_spent_key")),
    )
    op.create_table(
        "staff",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("is_admin", sa.Boolean(), nullable=False),
        sa.Column("password_hash", sa.String(length=200), nullable=True),
        sa.Column("disabled_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_staff")),
        sa.UniqueConstraint("name", name=op.f("uq_staff_name")),
    )
    op.create_table(
        "study",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("code", sa.String(length=64), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("marker", sa.String(length=64), nullable=True),
        sa.Column("camera", JSON, nullable=True),
        sa.Column("expects_after_pair", sa.Boolean(), nullable=False),
        sa.Column("after_window_minutes", sa.Integer(), nullable=False),
        sa.Column("location_policy", sa.String(length=16), nullable=False),
        sa.Column("location_decimals", sa.Integer(), nullable=True),
        sa.Column("retention_days", sa.Integer(), nullable=True),
        sa.Column("withdrawal_policy", sa.String(length=16), nullable=False),
        sa.Column("locale", sa.String(length=8), nullable=False),
        sa.Column("gives_feedback", sa.Boolean(), nullable=False),
        sa.Column("day_starts_minutes", sa.Integer(), nullable=False),
        sa.Column("shares_index", sa.Boolean(), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("change_seq", sa.BigInteger(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint(
            "(location_policy = 'round') = (location_decimals IS NOT NULL)",
            name=op.f("ck_study_decimals_to_round"),
        ),
        sa.CheckConstraint("locale IN ('en', 'de', 'es', 'zh')", name=op.f("ck_study_locale")),
        sa.CheckConstraint(
            "location_policy IN ('drop', 'round', 'keep')", name=op.f("ck_study_location_policy")
        ),
        sa.CheckConstraint(
            "withdrawal_policy IN ('keep', 'anonymise', 'erase')",
            name=op.f("ck_study_withdrawal_policy"),
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_study")),
        sa.UniqueConstraint("code", name=op.f("uq_study_code")),
    )
    op.create_table(
        "study_day_mark",
        sa.Column("id", BIG_ID, autoincrement=True, nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("local_date", sa.Date(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_study_day_mark")),
    )
    op.create_index(
        op.f("ix_study_day_mark_study_id_local_date"),
        "study_day_mark",
        ["study_id", "local_date"],
        unique=False,
    )
    op.create_table(
        "worker_lease",
        sa.Column("executor_id", sa.String(length=64), nullable=False),
        sa.Column("host", sa.String(length=255), nullable=False),
        sa.Column("pid", sa.Integer(), nullable=False),
        sa.Column("version", sa.String(length=32), nullable=False),
        sa.Column("started_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("heartbeat_at", sa.DateTime(timezone=True), nullable=False),
        sa.PrimaryKeyConstraint("executor_id", name=op.f("pk_worker_lease")),
    )
    op.create_table(
        "erasure_receipt",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("what", sa.String(length=16), nullable=False),
        sa.Column("policy", sa.String(length=16), nullable=False),
        sa.Column("counts", JSON, nullable=False),
        sa.Column("erased_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint(
            "what IN ('participant', 'meal', 'photographs')", name=op.f("ck_erasure_receipt_what")
        ),
        sa.ForeignKeyConstraint(
            ["study_id"], ["study.id"], name=op.f("fk_erasure_receipt_study_id_study")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_erasure_receipt")),
    )
    op.create_index(
        op.f("ix_erasure_receipt_study_id"), "erasure_receipt", ["study_id"], unique=False
    )
    op.create_table(
        "export",
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("staff_id", sa.Uuid(), nullable=False),
        sa.Column("spec", JSON, nullable=False),
        sa.Column("spec_sha256", sa.String(length=64), nullable=False),
        sa.Column("sha256", sa.String(length=64), nullable=True),
        sa.Column("blob_key", sa.String(length=300), nullable=True),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("claim", sa.Uuid(), nullable=True),
        sa.Column("heartbeat_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("begin_after", sa.DateTime(timezone=True), nullable=True),
        sa.Column("requested_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("started_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("finished_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("rows_written", sa.BigInteger(), nullable=False),
        sa.Column("rows_estimated", sa.BigInteger(), nullable=True),
        sa.Column("bytes", sa.BigInteger(), nullable=False),
        sa.Column("at_change_seq", sa.BigInteger(), nullable=True),
        sa.Column("failure_code", sa.String(length=64), nullable=True),
        sa.CheckConstraint(
            "(state = 'done') = (blob_key IS NOT NULL)", name=op.f("ck_export_file_of_what_is_done")
        ),
        sa.CheckConstraint(
            "state IN ('queued', 'running', 'done', 'failed', 'cancelled', 'expired')",
            name=op.f("ck_export_state"),
        ),
        sa.ForeignKeyConstraint(["staff_id"], ["staff.id"], name=op.f("fk_export_staff_id_staff")),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_export_study_id_study")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_export")),
        sa.UniqueConstraint("blob_key", name=op.f("uq_export_blob_key")),
    )
    op.create_index(op.f("ix_export_staff_id"), "export", ["staff_id"], unique=False)
    op.create_index(
        op.f("ix_export_study_id_requested_at_id"),
        "export",
        ["study_id", "requested_at", "id"],
        unique=False,
    )
    op.create_index(
        op.f("ix_export_state_requested_at"), "export", ["state", "requested_at"], unique=False
    )
    op.create_index(
        "uq_export_under_way",
        "export",
        ["study_id", "staff_id", "spec_sha256"],
        unique=True,
        sqlite_where=sa.text("state IN ('queued', 'running')"),
        postgresql_where=sa.text("state IN ('queued', 'running')"),
    )
    op.create_table(
        "food",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("release_id", sa.Integer(), nullable=False),
        sa.Column("key", sa.String(length=100), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(length=300), nullable=False),
        sa.Column("aliases", JSON, nullable=False),
        sa.Column("food_group", sa.String(length=100), nullable=False),
        sa.Column("form", sa.String(length=16), nullable=False),
        sa.Column("slice_form", sa.String(length=16), nullable=True),
        sa.Column("state", sa.String(length=16), nullable=True),
        sa.Column("is_mixed_dish", sa.Boolean(), nullable=False),
        sa.Column("refuse", JSON, nullable=False),
        sa.Column("probes", JSON, nullable=False),
        sa.Column("recipe_yield", sa.Double(), nullable=True),
        sa.Column("source_ids", JSON, nullable=False),
        sa.Column("superseded_by_id", sa.Integer(), nullable=True),
        sa.ForeignKeyConstraint(
            ["release_id"], ["food_release.id"], name=op.f("fk_food_release_id_food_release")
        ),
        sa.ForeignKeyConstraint(
            ["superseded_by_id"], ["food.id"], name=op.f("fk_food_superseded_by_id_food")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_food")),
        sa.UniqueConstraint(
            "release_id", "key", "version", name=op.f("uq_food_release_id_key_version")
        ),
    )
    op.create_index(op.f("ix_food_superseded_by_id"), "food", ["superseded_by_id"], unique=False)
    op.create_index(op.f("ix_food_key"), "food", ["key"], unique=False)
    op.create_index(
        op.f("ix_food_release_id_food_group"), "food", ["release_id", "food_group"], unique=False
    )
    op.create_table(
        "food_activation",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(length=100), nullable=False),
        sa.Column("release_id", sa.Integer(), nullable=True),
        sa.Column("author", sa.String(length=200), nullable=False),
        sa.Column("activated_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(
            ["release_id"],
            ["food_release.id"],
            name=op.f("fk_food_activation_release_id_food_release"),
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_food_activation")),
    )
    op.create_index(
        op.f("ix_food_activation_name_id"), "food_activation", ["name", "id"], unique=False
    )
    op.create_table(
        "food_word_trigram",
        sa.Column(
            "trigram",
            sa.String(length=3).with_variant(sa.String(length=3, collation="C"), "postgresql"),
            nullable=False,
        ),
        sa.Column(
            "word",
            sa.String(length=64).with_variant(sa.String(length=64, collation="C"), "postgresql"),
            nullable=False,
        ),
        sa.ForeignKeyConstraint(
            ["word"], ["food_word.word"], name=op.f("fk_food_word_trigram_word_food_word")
        ),
        sa.PrimaryKeyConstraint("trigram", "word", name=op.f("pk_food_word_trigram")),
    )
    op.create_table(
        "participant",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("code", sa.String(length=64), nullable=False),
        sa.Column("alias", sa.Uuid(), nullable=False),
        sa.Column("starts_on", sa.Date(), nullable=True),
        sa.Column("profile", JSON, nullable=True),
        sa.Column("withdrawn_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(
            ["study_id"], ["study.id"], name=op.f("fk_participant_study_id_study")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_participant")),
        sa.UniqueConstraint("alias", name=op.f("uq_participant_alias")),
        sa.UniqueConstraint("study_id", "code", name=op.f("uq_participant_study_id_code")),
    )
    op.create_table(
        "release",
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("staff_id", sa.Uuid(), nullable=False),
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("note", sa.Text(), nullable=False),
        sa.Column("filters", JSON, nullable=False),
        sa.Column("checksum", sa.String(length=64), nullable=True),
        sa.Column("frozen_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("altered_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("former_checksums", JSON, nullable=False),
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("claim", sa.Uuid(), nullable=True),
        sa.Column("heartbeat_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("begin_after", sa.DateTime(timezone=True), nullable=True),
        sa.Column("requested_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("started_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("finished_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("rows_written", sa.BigInteger(), nullable=False),
        sa.Column("rows_estimated", sa.BigInteger(), nullable=True),
        sa.Column("bytes", sa.BigInteger(), nullable=False),
        sa.Column("at_change_seq", sa.BigInteger(), nullable=True),
        sa.Column("failure_code", sa.String(length=64), nullable=True),
        sa.CheckConstraint(
            "state IN ('queued', 'running', 'ready', 'changing', 'failed')",
            name=op.f("ck_release_state"),
        ),
        sa.ForeignKeyConstraint(["staff_id"], ["staff.id"], name=op.f("fk_release_staff_id_staff")),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_release_study_id_study")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_release")),
        sa.UniqueConstraint("study_id", "name", name=op.f("uq_release_study_id_name")),
    )
    op.create_index(op.f("ix_release_staff_id"), "release", ["staff_id"], unique=False)
    op.create_index(
        op.f("ix_release_study_id_requested_at_id"),
        "release",
        ["study_id", "requested_at", "id"],
        unique=False,
    )
    op.create_index(
        op.f("ix_release_state_requested_at"), "release", ["state", "requested_at"], unique=False
    )
    op.create_table(
        "spent_code",
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("spent_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(
            ["study_id"], ["study.id"], name=op.f("fk_spent_code_study_id_study")
        ),
        sa.PrimaryKeyConstraint("study_id", "digest", name=op.f("pk_spent_code")),
    )
    op.create_table(
        "study_day_sum",
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("local_date", sa.Date(), nullable=False),
        sa.Column("told", sa.Integer(), nullable=False),
        sa.Column("told_closed", sa.Integer(), nullable=False),
        sa.Column("with_meal", sa.Integer(), nullable=False),
        sa.Column("closed", sa.Integer(), nullable=False),
        sa.Column("ate_nothing", sa.Integer(), nullable=False),
        sa.Column("open_days", sa.Integer(), nullable=False),
        sa.Column("open_energy_kcal", sa.Double(), nullable=True),
        sa.Column("meals", sa.Integer(), nullable=False),
        sa.Column("receiving_meals", sa.Integer(), nullable=False),
        sa.Column("queued_meals", sa.Integer(), nullable=False),
        sa.Column("processing_meals", sa.Integer(), nullable=False),
        sa.Column("estimated_meals", sa.Integer(), nullable=False),
        sa.Column("needs_review_meals", sa.Integer(), nullable=False),
        sa.Column("failed_meals", sa.Integer(), nullable=False),
        sa.Column("confirmed_meals", sa.Integer(), nullable=False),
        sa.Column("late_meals", sa.Integer(), nullable=False),
        sa.Column("located_meals", sa.Integer(), nullable=False),
        sa.Column("unmeasured_meals", sa.Integer(), nullable=False),
        sa.Column("items", sa.Integer(), nullable=False),
        sa.Column("unmeasured_items", sa.Integer(), nullable=False),
        sa.Column("provisional_items", sa.Integer(), nullable=False),
        sa.Column("delays", sa.LargeBinary(), nullable=False),
        sa.Column("energy_kcal", sa.LargeBinary(), nullable=False),
        sa.Column("protein_g", sa.LargeBinary(), nullable=False),
        sa.Column("fat_g", sa.LargeBinary(), nullable=False),
        sa.Column("carbohydrate_g", sa.LargeBinary(), nullable=False),
        sa.Column("fibre_g", sa.LargeBinary(), nullable=False),
        sa.Column("sugar_g", sa.LargeBinary(), nullable=False),
        sa.Column("saturated_fat_g", sa.LargeBinary(), nullable=False),
        sa.Column("sodium_mg", sa.LargeBinary(), nullable=False),
        sa.Column("potassium_mg", sa.LargeBinary(), nullable=False),
        sa.Column("vitamin_c_mg", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(
            ["study_id"], ["study.id"], name=op.f("fk_study_day_sum_study_id_study")
        ),
        sa.PrimaryKeyConstraint("study_id", "local_date", name=op.f("pk_study_day_sum")),
    )
    op.create_table(
        "study_density",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("food_key", sa.String(length=100), nullable=False),
        sa.Column("g_per_ml", sa.Double(), nullable=False),
        sa.Column("sd_g_per_ml", sa.Double(), nullable=False),
        sa.Column("state", sa.String(length=32), nullable=False),
        sa.Column("kind", sa.String(length=8), nullable=False),
        sa.Column("weighs", sa.String(length=8), nullable=False),
        sa.Column("source", sa.String(length=300), nullable=False),
        sa.Column("specimens", JSON, nullable=True),
        sa.Column("author", sa.String(length=200), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("measured_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("withdrawn_by", sa.String(length=200), nullable=True),
        sa.Column("withdrawn_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("withdrawal_reason", sa.Text(), nullable=True),
        sa.CheckConstraint("kind IN ('solid', 'bulk')", name=op.f("ck_study_density_kind")),
        sa.CheckConstraint("weighs IN ('as_seen', 'edible')", name=op.f("ck_study_density_weighs")),
        sa.CheckConstraint("g_per_ml > 0", name=op.f("ck_study_density_positive")),
        sa.ForeignKeyConstraint(
            ["study_id"], ["study.id"], name=op.f("fk_study_density_study_id_study")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_study_density")),
    )
    op.create_index(
        op.f("ix_study_density_study_id_food_key"),
        "study_density",
        ["study_id", "food_key"],
        unique=False,
    )
    op.create_table(
        "study_member",
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("staff_id", sa.Uuid(), nullable=False),
        sa.Column("role", sa.String(length=16), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint(
            "role IN ('viewer', 'reviewer', 'owner')", name=op.f("ck_study_member_role")
        ),
        sa.ForeignKeyConstraint(
            ["staff_id"], ["staff.id"], name=op.f("fk_study_member_staff_id_staff")
        ),
        sa.ForeignKeyConstraint(
            ["study_id"], ["study.id"], name=op.f("fk_study_member_study_id_study")
        ),
        sa.PrimaryKeyConstraint("study_id", "staff_id", name=op.f("pk_study_member")),
    )
    op.create_index(op.f("ix_study_member_staff_id"), "study_member", ["staff_id"], unique=False)
    op.create_table(
        "study_vessel",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("name", sa.String(length=100), nullable=False),
        sa.Column("name_key", sa.String(length=300), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(
            ["study_id"], ["study.id"], name=op.f("fk_study_vessel_study_id_study")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_study_vessel")),
    )
    op.create_index(
        op.f("ix_study_vessel_study_id_name_key"),
        "study_vessel",
        ["study_id", "name_key"],
        unique=True,
    )
    op.create_table(
        "tombstone",
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=True),
        sa.Column("change_seq", sa.BigInteger(), nullable=True),
        sa.Column("erased_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint(
            "kind IN ('participant', 'meal', 'token', 'record', 'day')",
            name=op.f("ck_tombstone_kind"),
        ),
        sa.ForeignKeyConstraint(
            ["study_id"], ["study.id"], name=op.f("fk_tombstone_study_id_study")
        ),
        sa.PrimaryKeyConstraint("kind", "digest", name=op.f("pk_tombstone")),
    )
    op.create_index(
        op.f("ix_tombstone_study_id_change_seq"),
        "tombstone",
        ["study_id", "change_seq"],
        unique=False,
    )
    op.create_table(
        "webhook",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("url", sa.String(length=500), nullable=False),
        sa.Column("events", JSON, nullable=False),
        sa.Column("secret_sealed", sa.String(length=300), nullable=False),
        sa.Column("author", sa.String(length=200), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("disabled_at", sa.DateTime(timezone=True), nullable=True),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_webhook_study_id_study")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_webhook")),
    )
    op.create_index(op.f("ix_webhook_study_id"), "webhook", ["study_id"], unique=False)
    op.create_table(
        "blob_deletion",
        sa.Column("blob_key", sa.String(length=300), nullable=False),
        sa.Column("receipt_id", sa.Uuid(), nullable=True),
        sa.Column("requested_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(
            ["receipt_id"],
            ["erasure_receipt.id"],
            name=op.f("fk_blob_deletion_receipt_id_erasure_receipt"),
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
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint(
            "kind IN ('closed', 'ate_nothing', 'reopened')", name=op.f("ck_day_event_kind")
        ),
        sa.CheckConstraint(
            "layer IN ('automatic', 'participant', 'reviewer')", name=op.f("ck_day_event_layer")
        ),
        sa.ForeignKeyConstraint(
            ["participant_id"],
            ["participant.id"],
            name=op.f("fk_day_event_participant_id_participant"),
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_day_event")),
    )
    op.create_index(
        op.f("ix_day_event_participant_id_local_date"),
        "day_event",
        ["participant_id", "local_date"],
        unique=False,
    )
    op.create_table(
        "day_sum",
        sa.Column("participant_id", sa.Uuid(), nullable=False),
        sa.Column("local_date", sa.Date(), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("status", sa.String(length=16), nullable=False),
        sa.Column("said_nothing", sa.Boolean(), nullable=False),
        sa.Column("meals", sa.Integer(), nullable=False),
        sa.Column("receiving_meals", sa.Integer(), nullable=False),
        sa.Column("queued_meals", sa.Integer(), nullable=False),
        sa.Column("processing_meals", sa.Integer(), nullable=False),
        sa.Column("estimated_meals", sa.Integer(), nullable=False),
        sa.Column("needs_review_meals", sa.Integer(), nullable=False),
        sa.Column("failed_meals", sa.Integer(), nullable=False),
        sa.Column("confirmed_meals", sa.Integer(), nullable=False),
        sa.Column("meals_after_closing", sa.Integer(), nullable=False),
        sa.Column("unmeasured_meals", sa.Integer(), nullable=False),
        sa.Column("late_meals", sa.Integer(), nullable=False),
        sa.Column("located_meals", sa.Integer(), nullable=False),
        sa.Column("median_upload_delay_seconds", sa.Double(), nullable=True),
        sa.Column("items", sa.Integer(), nullable=False),
        sa.Column("unmeasured_items", sa.Integer(), nullable=False),
        sa.Column("provisional_items", sa.Integer(), nullable=False),
        sa.Column("unseen_leftovers_items", sa.Integer(), nullable=False),
        sa.Column("consumed_g", sa.Double(), nullable=True),
        sa.Column("energy_kcal", sa.Double(), nullable=True),
        sa.Column("energy_kcal_coverage", sa.Double(), nullable=True),
        sa.Column("protein_g", sa.Double(), nullable=True),
        sa.Column("protein_g_coverage", sa.Double(), nullable=True),
        sa.Column("fat_g", sa.Double(), nullable=True),
        sa.Column("fat_g_coverage", sa.Double(), nullable=True),
        sa.Column("carbohydrate_g", sa.Double(), nullable=True),
        sa.Column("carbohydrate_g_coverage", sa.Double(), nullable=True),
        sa.Column("fibre_g", sa.Double(), nullable=True),
        sa.Column("fibre_g_coverage", sa.Double(), nullable=True),
        sa.Column("sugar_g", sa.Double(), nullable=True),
        sa.Column("sugar_g_coverage", sa.Double(), nullable=True),
        sa.Column("saturated_fat_g", sa.Double(), nullable=True),
        sa.Column("saturated_fat_g_coverage", sa.Double(), nullable=True),
        sa.Column("sodium_mg", sa.Double(), nullable=True),
        sa.Column("sodium_mg_coverage", sa.Double(), nullable=True),
        sa.Column("potassium_mg", sa.Double(), nullable=True),
        sa.Column("potassium_mg_coverage", sa.Double(), nullable=True),
        sa.Column("vitamin_c_mg", sa.Double(), nullable=True),
        sa.Column("vitamin_c_mg_coverage", sa.Double(), nullable=True),
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
        op.f("ix_day_sum_study_id_local_date_participant_id"),
        "day_sum",
        ["study_id", "local_date", "participant_id"],
        unique=False,
    )
    op.create_table(
        "device",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("participant_id", sa.Uuid(), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("model", sa.String(length=200), nullable=True),
        sa.Column("app_version", sa.String(length=64), nullable=True),
        sa.Column("clock_skew_seconds", sa.Double(), nullable=True),
        sa.Column("last_used_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("enrolled_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("revoked_at", sa.DateTime(timezone=True), nullable=True),
        sa.ForeignKeyConstraint(
            ["participant_id"],
            ["participant.id"],
            name=op.f("fk_device_participant_id_participant"),
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_device")),
    )
    op.create_index(op.f("ix_device_participant_id"), "device", ["participant_id"], unique=False)
    op.create_table(
        "diary_day",
        sa.Column("participant_id", sa.Uuid(), nullable=False),
        sa.Column("local_date", sa.Date(), nullable=False),
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("status", sa.String(length=16), nullable=False),
        sa.Column("ate_nothing", sa.Boolean(), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("changed_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("change_seq", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("status IN ('open', 'closed')", name=op.f("ck_diary_day_status")),
        sa.ForeignKeyConstraint(
            ["participant_id"],
            ["participant.id"],
            name=op.f("fk_diary_day_participant_id_participant"),
        ),
        sa.ForeignKeyConstraint(
            ["study_id"], ["study.id"], name=op.f("fk_diary_day_study_id_study")
        ),
        sa.PrimaryKeyConstraint("participant_id", "local_date", name=op.f("pk_diary_day")),
        sa.UniqueConstraint("id", name=op.f("uq_diary_day_id")),
    )
    op.create_index(
        op.f("ix_diary_day_study_id_local_date"),
        "diary_day",
        ["study_id", "local_date"],
        unique=False,
    )
    op.create_index(
        op.f("ix_diary_day_study_id_change_seq"),
        "diary_day",
        ["study_id", "change_seq"],
        unique=False,
    )
    op.create_table(
        "enrolment",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("participant_id", sa.Uuid(), nullable=False),
        sa.Column("code_sha256", sa.String(length=64), nullable=False),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("used_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(
            ["participant_id"],
            ["participant.id"],
            name=op.f("fk_enrolment_participant_id_participant"),
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_enrolment")),
        sa.UniqueConstraint("code_sha256", name=op.f("uq_enrolment_code_sha256")),
    )
    op.create_index(
        op.f("ix_enrolment_participant_id"), "enrolment", ["participant_id"], unique=False
    )
    op.create_table(
        "food_change",
        sa.Column("food_id", sa.Integer(), nullable=False),
        sa.Column("previous_id", sa.Integer(), nullable=True),
        sa.Column("author", sa.String(length=200), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("differences", JSON, nullable=False),
        sa.Column("changed_at", sa.DateTime(timezone=True), nullable=False),
        sa.ForeignKeyConstraint(["food_id"], ["food.id"], name=op.f("fk_food_change_food_id_food")),
        sa.ForeignKeyConstraint(
            ["previous_id"], ["food.id"], name=op.f("fk_food_change_previous_id_food")
        ),
        sa.PrimaryKeyConstraint("food_id", name=op.f("pk_food_change")),
    )
    op.create_index(
        op.f("ix_food_change_previous_id"), "food_change", ["previous_id"], unique=False
    )
    op.create_table(
        "food_code",
        sa.Column("system", sa.String(length=32), nullable=False),
        sa.Column("code", sa.String(length=300), nullable=False),
        sa.Column("food_id", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(["food_id"], ["food.id"], name=op.f("fk_food_code_food_id_food")),
        sa.PrimaryKeyConstraint("system", "code", "food_id", name=op.f("pk_food_code")),
    )
    op.create_index(op.f("ix_food_code_code"), "food_code", ["code"], unique=False)
    op.create_index(op.f("ix_food_code_food_id"), "food_code", ["food_id"], unique=False)
    op.create_table(
        "food_density",
        sa.Column("food_id", sa.Integer(), nullable=False),
        sa.Column("position", sa.Integer(), nullable=False),
        sa.Column("g_per_ml", sa.Double(), nullable=False),
        sa.Column("sd_g_per_ml", sa.Double(), nullable=False),
        sa.Column("state", sa.String(length=32), nullable=False),
        sa.Column("kind", sa.String(length=8), nullable=False),
        sa.Column("basis", sa.String(length=32), nullable=False),
        sa.Column("source", sa.String(length=300), nullable=False),
        sa.Column("weighs", sa.String(length=8), nullable=False),
        sa.CheckConstraint("kind IN ('solid', 'bulk')", name=op.f("ck_food_density_kind")),
        sa.CheckConstraint("weighs IN ('as_seen', 'edible')", name=op.f("ck_food_density_weighs")),
        sa.CheckConstraint("g_per_ml > 0", name=op.f("ck_food_density_positive")),
        sa.ForeignKeyConstraint(
            ["food_id"], ["food.id"], name=op.f("fk_food_density_food_id_food")
        ),
        sa.PrimaryKeyConstraint("food_id", "position", name=op.f("pk_food_density")),
    )
    op.create_table(
        "food_ingredient",
        sa.Column("food_id", sa.Integer(), nullable=False),
        sa.Column("position", sa.Integer(), nullable=False),
        sa.Column("ingredient_id", sa.Integer(), nullable=False),
        sa.Column("mass_g", sa.Double(), nullable=False),
        sa.Column("retention", JSON, nullable=False),
        sa.Column("retention_source", sa.String(length=300), nullable=True),
        sa.ForeignKeyConstraint(
            ["food_id"], ["food.id"], name=op.f("fk_food_ingredient_food_id_food")
        ),
        sa.ForeignKeyConstraint(
            ["ingredient_id"], ["food.id"], name=op.f("fk_food_ingredient_ingredient_id_food")
        ),
        sa.PrimaryKeyConstraint("food_id", "position", name=op.f("pk_food_ingredient")),
    )
    op.create_index(
        op.f("ix_food_ingredient_ingredient_id"), "food_ingredient", ["ingredient_id"], unique=False
    )
    op.create_table(
        "food_nutrient",
        sa.Column("food_id", sa.Integer(), nullable=False),
        sa.Column("component_id", sa.Integer(), nullable=False),
        sa.Column("per_100_g", sa.Double(), nullable=False),
        sa.ForeignKeyConstraint(
            ["component_id"], ["component.id"], name=op.f("fk_food_nutrient_component_id_component")
        ),
        sa.ForeignKeyConstraint(
            ["food_id"], ["food.id"], name=op.f("fk_food_nutrient_food_id_food")
        ),
        sa.PrimaryKeyConstraint("food_id", "component_id", name=op.f("pk_food_nutrient")),
    )
    op.create_table(
        "food_portion",
        sa.Column("food_id", sa.Integer(), nullable=False),
        sa.Column("position", sa.Integer(), nullable=False),
        sa.Column("sequence", sa.String(length=32), nullable=False),
        sa.Column("amount", sa.Double(), nullable=False),
        sa.Column("measure", sa.String(length=200), nullable=False),
        sa.Column("mass_g", sa.Double(), nullable=False),
        sa.ForeignKeyConstraint(
            ["food_id"], ["food.id"], name=op.f("fk_food_portion_food_id_food")
        ),
        sa.PrimaryKeyConstraint("food_id", "position", name=op.f("pk_food_portion")),
    )
    op.create_table(
        "food_posting",
        sa.Column(
            "word",
            sa.String(length=64).with_variant(sa.String(length=64, collation="C"), "postgresql"),
            nullable=False,
        ),
        sa.Column("rank", sa.Integer(), nullable=False),
        sa.Column("food_id", sa.Integer(), nullable=False),
        sa.Column("release_id", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(
            ["food_id"], ["food.id"], name=op.f("fk_food_posting_food_id_food")
        ),
        sa.PrimaryKeyConstraint(
            "word", "rank", "food_id", "release_id", name=op.f("pk_food_posting")
        ),
        sqlite_with_rowid=False,
    )
    op.create_index(
        op.f("ix_food_posting_food_id_word"), "food_posting", ["food_id", "word"], unique=False
    )
    op.create_table(
        "release_change",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("release_id", sa.Uuid(), nullable=False),
        sa.Column("deed", sa.String(length=16), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("new_code", sa.String(length=64), nullable=True),
        sa.Column("new_ids", sa.Uuid(), nullable=True),
        sa.Column("requested_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint(
            "(deed = 'anonymise') = (new_code IS NOT NULL)",
            name=op.f("ck_release_change_code_of_who_stays"),
        ),
        sa.CheckConstraint(
            "deed IN ('meal', 'erase', 'anonymise')", name=op.f("ck_release_change_deed")
        ),
        sa.ForeignKeyConstraint(
            ["release_id"], ["release.id"], name=op.f("fk_release_change_release_id_release")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_release_change")),
    )
    op.create_index(
        op.f("ix_release_change_release_id"), "release_change", ["release_id"], unique=False
    )
    op.create_table(
        "release_file",
        sa.Column("release_id", sa.Uuid(), nullable=False),
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("rows", sa.BigInteger(), nullable=True),
        sa.Column("bytes", sa.BigInteger(), nullable=False),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("blob_key", sa.String(length=300), nullable=False),
        sa.ForeignKeyConstraint(
            ["release_id"], ["release.id"], name=op.f("fk_release_file_release_id_release")
        ),
        sa.PrimaryKeyConstraint("release_id", "name", name=op.f("pk_release_file")),
        sa.UniqueConstraint("blob_key", name=op.f("uq_release_file_blob_key")),
    )
    op.create_table(
        "study_vessel_version",
        sa.Column("vessel_id", sa.Uuid(), nullable=False),
        sa.Column("version", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("rim_diameter_mm", sa.Double(), nullable=False),
        sa.Column("height_mm", sa.Double(), nullable=False),
        sa.Column("capacity_ml", sa.Double(), nullable=True),
        sa.Column("fill_line_mm", sa.Double(), nullable=True),
        sa.Column("fill_line_ml", sa.Double(), nullable=True),
        sa.Column("inside_profile_mm", JSON, nullable=False),
        sa.Column("is_retired", sa.Boolean(), nullable=False),
        sa.Column("author", sa.String(length=200), nullable=False),
        sa.Column("changed_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint(
            "kind IN ('mug', 'cup', 'glass', 'tall_glass', 'bowl', 'soup_bowl', 'deep_plate', 'other')",
            name=op.f("ck_study_vessel_version_kind"),
        ),
        sa.CheckConstraint(
            "(fill_line_mm IS NULL) = (fill_line_ml IS NULL)",
            name=op.f("ck_study_vessel_version_whole_fill_line"),
        ),
        sa.ForeignKeyConstraint(
            ["vessel_id"],
            ["study_vessel.id"],
            name=op.f("fk_study_vessel_version_vessel_id_study_vessel"),
        ),
        sa.PrimaryKeyConstraint("vessel_id", "version", name=op.f("pk_study_vessel_version")),
    )
    op.create_table(
        "access_token",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("token_sha256", sa.String(length=64), nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=True),
        sa.Column("scope", sa.String(length=16), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=True),
        sa.Column("device_id", sa.Uuid(), nullable=True),
        sa.Column("staff_id", sa.Uuid(), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("expires_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("last_used_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("revoked_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint(
            "kind IN ('device', 'session', 'personal')", name=op.f("ck_access_token_kind")
        ),
        sa.CheckConstraint("scope IN ('read', 'write')", name=op.f("ck_access_token_scope")),
        sa.CheckConstraint(
            "(device_id IS NULL) <> (staff_id IS NULL)", name=op.f("ck_access_token_one_owner")
        ),
        sa.ForeignKeyConstraint(
            ["device_id"], ["device.id"], name=op.f("fk_access_token_device_id_device")
        ),
        sa.ForeignKeyConstraint(
            ["staff_id"], ["staff.id"], name=op.f("fk_access_token_staff_id_staff")
        ),
        sa.ForeignKeyConstraint(
            ["study_id"], ["study.id"], name=op.f("fk_access_token_study_id_study")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_access_token")),
        sa.UniqueConstraint("token_sha256", name=op.f("uq_access_token_token_sha256")),
    )
    op.create_index(op.f("ix_access_token_device_id"), "access_token", ["device_id"], unique=False)
    op.create_index(op.f("ix_access_token_staff_id"), "access_token", ["staff_id"], unique=False)
    op.create_table(
        "camera_calibration",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("device_id", sa.Uuid(), nullable=True),
        sa.Column("model", sa.String(length=200), nullable=True),
        sa.Column("marker", sa.String(length=64), nullable=False),
        sa.Column("camera", JSON, nullable=False),
        sa.Column("rms_px", sa.Double(), nullable=False),
        sa.Column("photographs", sa.Integer(), nullable=False),
        sa.Column("author", sa.String(length=200), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("withdrawn_at", sa.DateTime(timezone=True), nullable=True),
        sa.ForeignKeyConstraint(
            ["device_id"], ["device.id"], name=op.f("fk_camera_calibration_device_id_device")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_camera_calibration")),
    )
    op.create_index(
        op.f("ix_camera_calibration_device_id"), "camera_calibration", ["device_id"], unique=False
    )
    op.create_index(
        op.f("ix_camera_calibration_model"), "camera_calibration", ["model"], unique=False
    )
    op.create_table(
        "meal",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("client_id", sa.Uuid(), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("participant_id", sa.Uuid(), nullable=False),
        sa.Column("device_id", sa.Uuid(), nullable=False),
        sa.Column("alias", sa.Uuid(), nullable=False),
        sa.Column("origin", sa.String(length=16), nullable=False),
        sa.Column("captured_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("utc_offset_minutes", sa.Integer(), nullable=False),
        sa.Column("time_zone", sa.String(length=64), nullable=False),
        sa.Column("local_date", sa.Date(), nullable=False),
        sa.Column("details", JSON, nullable=False),
        sa.Column("status", sa.String(length=16), nullable=False),
        sa.Column("stage", sa.String(length=32), nullable=True),
        sa.Column("failure_code", sa.String(length=64), nullable=True),
        sa.Column("failure_message", sa.Text(), nullable=True),
        sa.Column("failure_advice", sa.Text(), nullable=True),
        sa.Column("after_status", sa.String(length=16), nullable=True),
        sa.Column("after_details", JSON, nullable=True),
        sa.Column("after_failure_code", sa.String(length=64), nullable=True),
        sa.Column("after_failure_message", sa.Text(), nullable=True),
        sa.Column("after_failure_advice", sa.Text(), nullable=True),
        sa.Column("after_due_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("leftovers", JSON, nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("received_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("submitted_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint(
            "after_status IN ('receiving', 'queued', 'processing', 'estimated', "
            "'needs_review', 'failed', 'nothing_left')",
            name=op.f("ck_meal_after_status"),
        ),
        sa.CheckConstraint("origin IN ('photographed', 'declared')", name=op.f("ck_meal_origin")),
        sa.CheckConstraint(
            "status IN ('receiving', 'queued', 'processing', 'estimated', 'needs_review', 'failed', 'confirmed')",
            name=op.f("ck_meal_status"),
        ),
        sa.ForeignKeyConstraint(
            ["device_id"], ["device.id"], name=op.f("fk_meal_device_id_device")
        ),
        sa.ForeignKeyConstraint(
            ["participant_id"], ["participant.id"], name=op.f("fk_meal_participant_id_participant")
        ),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_meal_study_id_study")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_meal")),
        sa.UniqueConstraint("alias", name=op.f("uq_meal_alias")),
        sa.UniqueConstraint(
            "participant_id", "client_id", name=op.f("uq_meal_participant_id_client_id")
        ),
    )
    op.create_index(op.f("ix_meal_device_id"), "meal", ["device_id"], unique=False)
    op.create_index(op.f("ix_meal_after_status"), "meal", ["after_status"], unique=False)
    op.create_index(op.f("ix_meal_after_due_at"), "meal", ["after_due_at"], unique=False)
    op.create_index(
        op.f("ix_meal_study_id_captured_at_id"),
        "meal",
        ["study_id", "captured_at", "id"],
        unique=False,
    )
    op.create_index(
        op.f("ix_meal_participant_id_local_date"),
        "meal",
        ["participant_id", "local_date"],
        unique=False,
    )
    op.create_index(
        op.f("ix_meal_study_id_local_date_participant_id"),
        "meal",
        ["study_id", "local_date", "participant_id"],
        unique=False,
    )
    op.create_index(
        op.f("ix_meal_status_submitted_at"), "meal", ["status", "submitted_at"], unique=False
    )
    op.create_index(
        "ix_meal_list_of_status",
        "meal",
        ["study_id", "status", "origin", "captured_at", "id", "local_date"],
        unique=False,
    )
    op.create_index(
        "ix_meal_list_of_participant",
        "meal",
        ["participant_id", "captured_at", "id", "local_date"],
        unique=False,
    )
    op.create_index(
        "ix_meal_list_of_failure",
        "meal",
        ["study_id", "failure_code", "captured_at", "id", "local_date"],
        unique=False,
        sqlite_where=sa.text("failure_code IS NOT NULL"),
        postgresql_where=sa.text("failure_code IS NOT NULL"),
    )
    op.create_index(
        "ix_meal_list_of_after",
        "meal",
        ["study_id", "after_status", "captured_at", "id", "local_date"],
        unique=False,
        sqlite_where=sa.text("after_status IS NOT NULL"),
        postgresql_where=sa.text("after_status IS NOT NULL"),
    )
    op.create_index(op.f("ix_meal_client_id"), "meal", ["client_id"], unique=False)
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
        sa.Column("old", JSON, nullable=False),
        sa.Column("new", JSON, nullable=False),
        sa.Column("request_sha256", sa.String(length=64), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint(
            "kind IN ('confirm', 'reject', 'set_food', 'set_volume', 'set_mass', 'set_share', "
            "'set_leftover', 'add', 'declare', 'split', 'merge', 'redraw', 'nothing_left', "
            "'confirm_meal', 'comment', 'question', 'answer', 'undo')",
            name=op.f("ck_meal_event_kind"),
        ),
        sa.CheckConstraint(
            "layer IN ('automatic', 'participant', 'reviewer')", name=op.f("ck_meal_event_layer")
        ),
        sa.ForeignKeyConstraint(
            ["device_id"], ["device.id"], name=op.f("fk_meal_event_device_id_device")
        ),
        sa.ForeignKeyConstraint(["meal_id"], ["meal.id"], name=op.f("fk_meal_event_meal_id_meal")),
        sa.ForeignKeyConstraint(
            ["staff_id"], ["staff.id"], name=op.f("fk_meal_event_staff_id_staff")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_meal_event")),
        sa.UniqueConstraint("meal_id", "sequence", name=op.f("uq_meal_event_meal_id_sequence")),
    )
    op.create_index(op.f("ix_meal_event_item_id"), "meal_event", ["item_id"], unique=False)
    op.create_index(op.f("ix_meal_event_device_id"), "meal_event", ["device_id"], unique=False)
    op.create_index(
        "ix_meal_event_questions",
        "meal_event",
        ["meal_id"],
        unique=False,
        sqlite_where=sa.text("kind = 'question'"),
        postgresql_where=sa.text("kind = 'question'"),
    )
    op.create_table(
        "meal_image",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("meal_id", sa.Uuid(), nullable=False),
        sa.Column("slot", sa.String(length=16), nullable=False),
        sa.Column("media_type", sa.String(length=32), nullable=False),
        sa.Column("width_px", sa.Integer(), nullable=False),
        sa.Column("height_px", sa.Integer(), nullable=False),
        sa.Column("bytes", sa.BigInteger(), nullable=False),
        sa.Column("received_sha256", sa.String(length=64), nullable=False),
        sa.Column("stored_sha256", sa.String(length=64), nullable=False),
        sa.Column("blob_key", sa.String(length=200), nullable=False),
        sa.Column("received_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("erased_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint(
            "slot IN ('left', 'right', 'view3', 'view4', 'view5', 'view6', 'view7', 'view8', 'after_left', "
            "'after_right')",
            name=op.f("ck_meal_image_slot"),
        ),
        sa.ForeignKeyConstraint(["meal_id"], ["meal.id"], name=op.f("fk_meal_image_meal_id_meal")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_meal_image")),
        sa.UniqueConstraint("blob_key", name=op.f("uq_meal_image_blob_key")),
        sa.UniqueConstraint("meal_id", "slot", name=op.f("uq_meal_image_meal_id_slot")),
    )
    op.create_table(
        "webhook_delivery",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("webhook_id", sa.Uuid(), nullable=False),
        sa.Column("event", sa.String(length=64), nullable=False),
        sa.Column("payload", JSON, nullable=False),
        sa.Column("meal_id", sa.Uuid(), nullable=True),
        sa.Column("participant_id", sa.Uuid(), nullable=True),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("next_try_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("last_status", sa.Integer(), nullable=True),
        sa.Column("last_error", sa.String(length=200), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("delivered_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint(
            "state IN ('waiting', 'delivered', 'given_up')", name=op.f("ck_webhook_delivery_state")
        ),
        sa.ForeignKeyConstraint(
            ["meal_id"], ["meal.id"], name=op.f("fk_webhook_delivery_meal_id_meal")
        ),
        sa.ForeignKeyConstraint(
            ["participant_id"],
            ["participant.id"],
            name=op.f("fk_webhook_delivery_participant_id_participant"),
        ),
        sa.ForeignKeyConstraint(
            ["webhook_id"], ["webhook.id"], name=op.f("fk_webhook_delivery_webhook_id_webhook")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_webhook_delivery")),
    )
    op.create_index(
        op.f("ix_webhook_delivery_meal_id"), "webhook_delivery", ["meal_id"], unique=False
    )
    op.create_index(
        op.f("ix_webhook_delivery_participant_id"),
        "webhook_delivery",
        ["participant_id"],
        unique=False,
    )
    op.create_index(
        op.f("ix_webhook_delivery_state_next_try_at"),
        "webhook_delivery",
        ["state", "next_try_at"],
        unique=False,
    )
    op.create_index(
        op.f("ix_webhook_delivery_webhook_id_created_at"),
        "webhook_delivery",
        ["webhook_id", "created_at"],
        unique=False,
    )
    op.create_table(
        "job",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("meal_id", sa.Uuid(), nullable=False),
        sa.Column("purpose", sa.String(length=16), nullable=False),
        sa.Column("event_id", sa.Uuid(), nullable=True),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("turn", sa.BigInteger(), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=True),
        sa.Column("is_background", sa.Boolean(), nullable=False),
        sa.Column("protocol", sa.Integer(), nullable=False),
        sa.Column("executor_id", sa.String(length=64), nullable=True),
        sa.Column("takeovers", sa.Integer(), nullable=False),
        sa.Column("result_key", sa.String(length=300), nullable=True),
        sa.Column("request_id", sa.String(length=32), nullable=True),
        sa.Column("enqueued_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("started_at", sa.DateTime(timezone=True), nullable=True),
        sa.Column("finished_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint(
            "(state IN ('done', 'failed')) = (finished_at IS NOT NULL)",
            name=op.f("ck_job_finished"),
        ),
        sa.CheckConstraint(
            "purpose IN ('meal', 'after', 'remeasure', 'rerun', 'rerun_after')",
            name=op.f("ck_job_purpose"),
        ),
        sa.CheckConstraint(
            "state IN ('queued', 'processing', 'done', 'failed')", name=op.f("ck_job_state")
        ),
        sa.ForeignKeyConstraint(
            ["event_id"], ["meal_event.id"], name=op.f("fk_job_event_id_meal_event")
        ),
        sa.ForeignKeyConstraint(["meal_id"], ["meal.id"], name=op.f("fk_job_meal_id_meal")),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_job_study_id_study")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_job")),
    )
    op.create_index(
        "ix_job_claimed",
        "job",
        ["executor_id"],
        unique=False,
        sqlite_where=sa.text("executor_id IS NOT NULL AND finished_at IS NULL"),
        postgresql_where=sa.text("executor_id IS NOT NULL AND finished_at IS NULL"),
    )
    op.create_index(op.f("ix_job_event_id"), "job", ["event_id"], unique=False)
    op.create_index(op.f("ix_job_meal_id"), "job", ["meal_id"], unique=False)
    op.create_index(op.f("ix_job_state_enqueued_at"), "job", ["state", "enqueued_at"], unique=False)
    op.create_index(
        op.f("ix_job_study_id_turn"),
        "job",
        ["study_id", "turn"],
        unique=False,
        sqlite_where=sa.text("study_id IS NOT NULL"),
        postgresql_where=sa.text("study_id IS NOT NULL"),
    )
    op.create_index(
        "ix_job_turn_of_begun",
        "job",
        ["turn"],
        unique=False,
        sqlite_where=sa.text("started_at IS NOT NULL"),
        postgresql_where=sa.text("started_at IS NOT NULL"),
    )
    op.create_index(
        "ix_job_waiting",
        "job",
        ["is_background", "turn", "enqueued_at", "id"],
        unique=False,
        sqlite_where=sa.text("executor_id IS NULL AND finished_at IS NULL"),
        postgresql_where=sa.text("executor_id IS NULL AND finished_at IS NULL"),
    )
    op.create_table(
        "remeasurement",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("author", sa.String(length=200), nullable=False),
        sa.Column("selection", sa.String(length=64), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("pipeline_version", sa.String(length=32), nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("ended_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint(
            "(state = 'running') = (ended_at IS NULL)", name=op.f("ck_remeasurement_ended")
        ),
        sa.CheckConstraint(
            "state IN ('running', 'stopped', 'done')", name=op.f("ck_remeasurement_state")
        ),
        sa.ForeignKeyConstraint(
            ["study_id"], ["study.id"], name=op.f("fk_remeasurement_study_id_study")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_remeasurement")),
    )
    op.create_index(
        op.f("ix_remeasurement_study_id_created_at_id"),
        "remeasurement",
        ["study_id", "created_at", "id"],
        unique=False,
    )
    op.create_index(
        "uq_remeasurement_running_of_study",
        "remeasurement",
        ["study_id"],
        unique=True,
        sqlite_where=sa.text("state = 'running'"),
        postgresql_where=sa.text("state = 'running'"),
    )
    op.create_table(
        "run",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("meal_id", sa.Uuid(), nullable=False),
        sa.Column("purpose", sa.String(length=16), nullable=False),
        sa.Column("method", sa.String(length=32), nullable=False),
        sa.Column("pipeline_version", sa.String(length=32), nullable=False),
        sa.Column("marker", sa.String(length=64), nullable=False),
        sa.Column("camera", JSON, nullable=True),
        sa.Column("parameters", JSON, nullable=False),
        sa.Column("colour", JSON, nullable=True),
        sa.Column("stages", JSON, nullable=False),
        sa.Column("seconds", sa.Double(), nullable=False),
        sa.Column("food_releases", JSON, nullable=False),
        sa.Column("failure_code", sa.String(length=64), nullable=True),
        sa.Column("failure_message", sa.Text(), nullable=True),
        sa.Column("result_key", sa.String(length=300), nullable=False),
        sa.Column("remeasurement_id", sa.Uuid(), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint(
            "purpose IN ('meal', 'after', 'remeasure', 'rerun', 'rerun_after')",
            name=op.f("ck_run_purpose"),
        ),
        sa.ForeignKeyConstraint(["id"], ["job.id"], name=op.f("fk_run_id_job")),
        sa.ForeignKeyConstraint(["meal_id"], ["meal.id"], name=op.f("fk_run_meal_id_meal")),
        sa.ForeignKeyConstraint(
            ["remeasurement_id"],
            ["remeasurement.id"],
            name=op.f("fk_run_remeasurement_id_remeasurement"),
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_run")),
        sa.UniqueConstraint("result_key", name=op.f("uq_run_result_key")),
    )
    op.create_index(op.f("ix_run_meal_id"), "run", ["meal_id"], unique=False)
    op.create_index(op.f("ix_run_remeasurement_id"), "run", ["remeasurement_id"], unique=False)
    op.create_table(
        "item",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("meal_id", sa.Uuid(), nullable=False),
        sa.Column("run_id", sa.Uuid(), nullable=True),
        sa.Column("origin", sa.String(length=16), nullable=False),
        sa.Column("parent_id", sa.Uuid(), nullable=True),
        sa.Column("event_id", sa.Uuid(), nullable=True),
        sa.Column("position", sa.Integer(), nullable=False),
        sa.Column("rings", JSON, nullable=False),
        sa.Column("volume_ml", sa.Double(), nullable=True),
        sa.Column("volume_low_ml", sa.Double(), nullable=True),
        sa.Column("volume_high_ml", sa.Double(), nullable=True),
        sa.Column("relative_sd", JSON, nullable=False),
        sa.Column("flags", JSON, nullable=False),
        sa.Column("traits", JSON, nullable=False),
        sa.CheckConstraint(
            "(run_id IS NULL) = (origin NOT IN ('pipeline', 'after'))",
            name=op.f("ck_item_run_of_what_it_found"),
        ),
        sa.CheckConstraint(
            "origin IN ('pipeline', 'after', 'declared', 'added', 'split', 'merged')",
            name=op.f("ck_item_origin"),
        ),
        sa.CheckConstraint(
            "(volume_ml IS NULL) = (volume_low_ml IS NULL) AND (volume_ml IS NULL) = (volume_high_ml IS NULL)",
            name=op.f("ck_item_volume_with_interval"),
        ),
        sa.ForeignKeyConstraint(
            ["event_id"], ["meal_event.id"], name=op.f("fk_item_event_id_meal_event")
        ),
        sa.ForeignKeyConstraint(["meal_id"], ["meal.id"], name=op.f("fk_item_meal_id_meal")),
        sa.ForeignKeyConstraint(["parent_id"], ["item.id"], name=op.f("fk_item_parent_id_item")),
        sa.ForeignKeyConstraint(["run_id"], ["run.id"], name=op.f("fk_item_run_id_run")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_item")),
        sa.UniqueConstraint("run_id", "position", name=op.f("uq_item_run_id_position")),
    )
    op.create_index(op.f("ix_item_meal_id"), "item", ["meal_id"], unique=False)
    op.create_index(op.f("ix_item_parent_id"), "item", ["parent_id"], unique=False)
    op.create_index(op.f("ix_item_event_id"), "item", ["event_id"], unique=False)
    op.create_table(
        "run_artefact",
        sa.Column("run_id", sa.Uuid(), nullable=False),
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("media_type", sa.String(length=64), nullable=False),
        sa.Column("bytes", sa.BigInteger(), nullable=False),
        sa.Column("sha256", sa.String(length=64), nullable=False),
        sa.Column("blob_key", sa.String(length=300), nullable=False),
        sa.ForeignKeyConstraint(["run_id"], ["run.id"], name=op.f("fk_run_artefact_run_id_run")),
        sa.PrimaryKeyConstraint("run_id", "name", name=op.f("pk_run_artefact")),
        sa.UniqueConstraint("blob_key", name=op.f("uq_run_artefact_blob_key")),
    )
    op.create_table(
        "effective_record",
        sa.Column("item_id", sa.Uuid(), nullable=False),
        sa.Column("meal_id", sa.Uuid(), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("participant_id", sa.Uuid(), nullable=False),
        sa.Column("captured_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("local_date", sa.Date(), nullable=False),
        sa.Column("status", sa.String(length=16), nullable=False),
        sa.Column("origin", sa.String(length=16), nullable=False),
        sa.Column("provisional", sa.Boolean(), nullable=False),
        sa.Column("reviewed", sa.Boolean(), nullable=False),
        sa.Column("food_id", sa.Integer(), nullable=True),
        sa.Column("volume_ml", sa.Double(), nullable=True),
        sa.Column("volume_low_ml", sa.Double(), nullable=True),
        sa.Column("volume_high_ml", sa.Double(), nullable=True),
        sa.Column("density_g_per_ml", sa.Double(), nullable=True),
        sa.Column("density_source", sa.String(length=300), nullable=True),
        sa.Column("mass_g", sa.Double(), nullable=True),
        sa.Column("mass_low_g", sa.Double(), nullable=True),
        sa.Column("mass_high_g", sa.Double(), nullable=True),
        sa.Column("edible_g", sa.Double(), nullable=True),
        sa.Column("share", sa.Double(), nullable=False),
        sa.Column("left_g", sa.Double(), nullable=True),
        sa.Column("consumed_g", sa.Double(), nullable=True),
        sa.Column("consumed_low_g", sa.Double(), nullable=True),
        sa.Column("consumed_high_g", sa.Double(), nullable=True),
        sa.Column("energy_kcal", sa.Double(), nullable=True),
        sa.Column("protein_g", sa.Double(), nullable=True),
        sa.Column("fat_g", sa.Double(), nullable=True),
        sa.Column("carbohydrate_g", sa.Double(), nullable=True),
        sa.Column("fibre_g", sa.Double(), nullable=True),
        sa.Column("sugar_g", sa.Double(), nullable=True),
        sa.Column("saturated_fat_g", sa.Double(), nullable=True),
        sa.Column("sodium_mg", sa.Double(), nullable=True),
        sa.Column("potassium_mg", sa.Double(), nullable=True),
        sa.Column("vitamin_c_mg", sa.Double(), nullable=True),
        sa.Column("flags", JSON, nullable=False),
        sa.Column("doubt", sa.Double(), nullable=False),
        sa.Column("food_version", sa.Integer(), nullable=True),
        sa.Column("run_id", sa.Uuid(), nullable=True),
        sa.Column("details", JSON, nullable=False),
        sa.Column("change_seq", sa.BigInteger(), nullable=False),
        sa.CheckConstraint(
            "origin IN ('pipeline', 'after', 'declared', 'added', 'split', 'merged')",
            name=op.f("ck_effective_record_origin"),
        ),
        sa.CheckConstraint(
            "status IN ('proposed', 'needs_review', 'confirmed', 'corrected', 'rejected')",
            name=op.f("ck_effective_record_status"),
        ),
        sa.ForeignKeyConstraint(
            ["food_id"], ["food.id"], name=op.f("fk_effective_record_food_id_food")
        ),
        sa.ForeignKeyConstraint(
            ["item_id"], ["item.id"], name=op.f("fk_effective_record_item_id_item")
        ),
        sa.ForeignKeyConstraint(
            ["meal_id"], ["meal.id"], name=op.f("fk_effective_record_meal_id_meal")
        ),
        sa.ForeignKeyConstraint(
            ["participant_id"],
            ["participant.id"],
            name=op.f("fk_effective_record_participant_id_participant"),
        ),
        sa.ForeignKeyConstraint(
            ["study_id"], ["study.id"], name=op.f("fk_effective_record_study_id_study")
        ),
        sa.PrimaryKeyConstraint("item_id", name=op.f("pk_effective_record")),
    )
    op.create_index(
        op.f("ix_effective_record_meal_id"), "effective_record", ["meal_id"], unique=False
    )
    op.create_index(
        op.f("ix_effective_record_captured_at_item_id"),
        "effective_record",
        ["captured_at", "item_id"],
        unique=False,
    )
    op.create_index(
        op.f("ix_effective_record_study_id_captured_at_item_id"),
        "effective_record",
        ["study_id", "captured_at", "item_id"],
        unique=False,
    )
    op.create_index(
        op.f("ix_effective_record_study_id_status_captured_at_item_id"),
        "effective_record",
        ["study_id", "status", "captured_at", "item_id"],
        unique=False,
    )
    op.create_index(
        op.f("ix_effective_record_food_id_study_id_status_captured_at_item_id"),
        "effective_record",
        ["food_id", "study_id", "status", "captured_at", "item_id"],
        unique=False,
    )
    op.create_index(
        op.f("ix_effective_record_participant_id_captured_at_item_id"),
        "effective_record",
        ["participant_id", "captured_at", "item_id"],
        unique=False,
    )
    op.create_index(
        op.f("ix_effective_record_study_id_change_seq"),
        "effective_record",
        ["study_id", "change_seq"],
        unique=False,
    )
    op.create_index(
        op.f("ix_effective_record_study_id_reviewed_status_doubt_item_id"),
        "effective_record",
        ["study_id", "reviewed", "status", "doubt", "item_id"],
        unique=False,
    )
    op.create_index(
        "ix_effective_record_queue_of_food",
        "effective_record",
        ["food_id", "study_id", "reviewed", "status", "doubt", "item_id"],
        unique=False,
    )
    op.create_index(
        "ix_effective_record_queue_of_provisional",
        "effective_record",
        ["study_id", "reviewed", "doubt", "item_id"],
        unique=False,
        sqlite_where=sa.text("provisional IS 1"),
        postgresql_where=sa.text("provisional IS true"),
    )
    op.create_index(
        op.f("ix_effective_record_participant_id_local_date"),
        "effective_record",
        ["participant_id", "local_date"],
        unique=False,
    )
    op.create_index(
        "ix_effective_record_meals_of_food",
        "effective_record",
        ["food_id", "study_id", "captured_at", "meal_id", "local_date"],
        unique=False,
        sqlite_where=sa.text("status <> 'rejected'"),
        postgresql_where=sa.text("status <> 'rejected'"),
    )
    op.create_index(
        "ix_effective_record_meals_of_flags",
        "effective_record",
        ["study_id", "flags", "captured_at", "meal_id", "local_date"],
        unique=False,
        sqlite_where=sa.text("status <> 'rejected' AND flags <> '[]'"),
        postgresql_where=sa.text("status <> 'rejected' AND flags <> '[]'"),
    )
    op.create_index(
        "ix_effective_record_meals_to_review",
        "effective_record",
        ["study_id", "captured_at", "meal_id", "local_date"],
        unique=False,
        sqlite_where=sa.text("status <> 'rejected' AND reviewed IS 0"),
        postgresql_where=sa.text("status <> 'rejected' AND reviewed IS false"),
    )
    op.create_table(
        "index_entry",
        sa.Column("item_id", sa.Uuid(), nullable=False),
        sa.Column("run_id", sa.Uuid(), nullable=False),
        sa.Column("vcm_version", sa.String(length=16), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("participant_id", sa.Uuid(), nullable=False),
        sa.Column("food_key", sa.String(length=100), nullable=False),
        sa.Column("volume_ml", sa.Double(), nullable=True),
        sa.Column("captured_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("day_minute", sa.Integer(), nullable=False),
        sa.CheckConstraint(
            "day_minute >= 0 AND day_minute < 1440", name=op.f("ck_index_entry_day_minute")
        ),
        sa.ForeignKeyConstraint(
            ["item_id"], ["item.id"], name=op.f("fk_index_entry_item_id_item"), ondelete="CASCADE"
        ),
        sa.ForeignKeyConstraint(
            ["participant_id"],
            ["participant.id"],
            name=op.f("fk_index_entry_participant_id_participant"),
        ),
        sa.ForeignKeyConstraint(["run_id"], ["run.id"], name=op.f("fk_index_entry_run_id_run")),
        sa.ForeignKeyConstraint(
            ["study_id"], ["study.id"], name=op.f("fk_index_entry_study_id_study")
        ),
        sa.PrimaryKeyConstraint("item_id", name=op.f("pk_index_entry")),
    )
    op.create_index(op.f("ix_index_entry_run_id"), "index_entry", ["run_id"], unique=False)
    op.create_index(
        op.f("ix_index_entry_participant_id"), "index_entry", ["participant_id"], unique=False
    )
    op.create_index(
        op.f("ix_index_entry_study_id_food_key_captured_at"),
        "index_entry",
        ["study_id", "food_key", "captured_at"],
        unique=False,
    )
    op.create_table(
        "item_candidate",
        sa.Column("item_id", sa.Uuid(), nullable=False),
        sa.Column("position", sa.Integer(), nullable=False),
        sa.Column("food_id", sa.Integer(), nullable=False),
        sa.Column("probability", sa.Double(), nullable=True),
        sa.Column("source", sa.String(length=16), nullable=False),
        sa.Column("run_id", sa.Uuid(), nullable=True),
        sa.ForeignKeyConstraint(
            ["food_id"], ["food.id"], name=op.f("fk_item_candidate_food_id_food")
        ),
        sa.ForeignKeyConstraint(
            ["item_id"], ["item.id"], name=op.f("fk_item_candidate_item_id_item")
        ),
        sa.ForeignKeyConstraint(["run_id"], ["run.id"], name=op.f("fk_item_candidate_run_id_run")),
        sa.PrimaryKeyConstraint("item_id", "position", name=op.f("pk_item_candidate")),
    )
    op.create_index(op.f("ix_item_candidate_run_id"), "item_candidate", ["run_id"], unique=False)
    op.create_table(
        "item_food",
        sa.Column("item_id", sa.Uuid(), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("food_id", sa.Integer(), nullable=False),
        sa.Column("lies_as", sa.String(length=16), nullable=True),
        sa.Column("density_g_per_ml", sa.Double(), nullable=True),
        sa.Column("density_sd_g_per_ml", sa.Double(), nullable=True),
        sa.Column("density_state", sa.String(length=32), nullable=True),
        sa.Column("density_kind", sa.String(length=8), nullable=True),
        sa.Column("density_basis", sa.String(length=32), nullable=True),
        sa.Column("density_source", sa.String(length=300), nullable=True),
        sa.Column("density_weighs", sa.String(length=8), nullable=True),
        sa.Column("edible_share", sa.Double(), nullable=False),
        sa.Column("layer", sa.String(length=16), nullable=False),
        sa.Column("event_id", sa.Uuid(), nullable=True),
        sa.Column("recompute_id", sa.Uuid(), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint(
            "layer IN ('automatic', 'participant', 'reviewer')", name=op.f("ck_item_food_layer")
        ),
        sa.ForeignKeyConstraint(
            ["event_id"], ["meal_event.id"], name=op.f("fk_item_food_event_id_meal_event")
        ),
        sa.ForeignKeyConstraint(["food_id"], ["food.id"], name=op.f("fk_item_food_food_id_food")),
        sa.ForeignKeyConstraint(["item_id"], ["item.id"], name=op.f("fk_item_food_item_id_item")),
        sa.ForeignKeyConstraint(
            ["recompute_id"], ["recompute.id"], name=op.f("fk_item_food_recompute_id_recompute")
        ),
        sa.PrimaryKeyConstraint("item_id", "version", name=op.f("pk_item_food")),
    )
    op.create_index(op.f("ix_item_food_event_id"), "item_food", ["event_id"], unique=False)
    op.create_table(
        "item_identification",
        sa.Column("item_id", sa.Uuid(), nullable=False),
        sa.Column("run_id", sa.Uuid(), nullable=False),
        sa.Column("vcm_version", sa.String(length=16), nullable=False),
        sa.Column("vector", sa.LargeBinary(), nullable=False),
        sa.Column("index_version", sa.String(length=100), nullable=True),
        sa.Column("none_probability", sa.Double(), nullable=True),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint(
            "(index_version IS NULL) = (none_probability IS NULL)",
            name=op.f("ck_item_identification_identified_by_an_index"),
        ),
        sa.ForeignKeyConstraint(
            ["item_id"],
            ["item.id"],
            name=op.f("fk_item_identification_item_id_item"),
            ondelete="CASCADE",
        ),
        sa.ForeignKeyConstraint(
            ["run_id"], ["run.id"], name=op.f("fk_item_identification_run_id_run")
        ),
        sa.PrimaryKeyConstraint(
            "item_id", "run_id", "vcm_version", name=op.f("pk_item_identification")
        ),
    )
    op.create_index(
        op.f("ix_item_identification_run_id"), "item_identification", ["run_id"], unique=False
    )
    op.create_table(
        "item_measure",
        sa.Column("item_id", sa.Uuid(), nullable=False),
        sa.Column("run_id", sa.Uuid(), nullable=False),
        sa.Column("event_id", sa.Uuid(), nullable=True),
        sa.Column("rings", JSON, nullable=False),
        sa.Column("volume_ml", sa.Double(), nullable=True),
        sa.Column("volume_low_ml", sa.Double(), nullable=True),
        sa.Column("volume_high_ml", sa.Double(), nullable=True),
        sa.Column("relative_sd", JSON, nullable=False),
        sa.Column("flags", JSON, nullable=False),
        sa.ForeignKeyConstraint(
            ["event_id"], ["meal_event.id"], name=op.f("fk_item_measure_event_id_meal_event")
        ),
        sa.ForeignKeyConstraint(
            ["item_id"], ["item.id"], name=op.f("fk_item_measure_item_id_item")
        ),
        sa.ForeignKeyConstraint(["run_id"], ["run.id"], name=op.f("fk_item_measure_run_id_run")),
        sa.PrimaryKeyConstraint("item_id", "run_id", name=op.f("pk_item_measure")),
        sa.UniqueConstraint("item_id", "event_id", name=op.f("uq_item_measure_item_id_event_id")),
    )
    op.create_index(op.f("ix_item_measure_event_id"), "item_measure", ["event_id"], unique=False)
    op.create_index(op.f("ix_item_measure_run_id"), "item_measure", ["run_id"], unique=False)
    op.create_table(
        "leftover",
        sa.Column("after_item_id", sa.Uuid(), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("item_id", sa.Uuid(), nullable=True),
        sa.Column("leftover_class", sa.String(length=16), nullable=False),
        sa.Column("layer", sa.String(length=16), nullable=False),
        sa.Column("event_id", sa.Uuid(), nullable=True),
        sa.Column("flags", JSON, nullable=False),
        sa.Column("created_at", sa.DateTime(timezone=True), nullable=False),
        sa.CheckConstraint(
            "(item_id IS NULL) = (leftover_class = 'unmatched')",
            name=op.f("ck_leftover_matched_to_an_item"),
        ),
        sa.CheckConstraint(
            "layer IN ('automatic', 'participant', 'reviewer')", name=op.f("ck_leftover_layer")
        ),
        sa.CheckConstraint(
            "leftover_class IN ('food_left', 'refuse', 'unmatched')",
            name=op.f("ck_leftover_leftover_class"),
        ),
        sa.ForeignKeyConstraint(
            ["after_item_id"], ["item.id"], name=op.f("fk_leftover_after_item_id_item")
        ),
        sa.ForeignKeyConstraint(
            ["event_id"], ["meal_event.id"], name=op.f("fk_leftover_event_id_meal_event")
        ),
        sa.ForeignKeyConstraint(["item_id"], ["item.id"], name=op.f("fk_leftover_item_id_item")),
        sa.PrimaryKeyConstraint("after_item_id", "version", name=op.f("pk_leftover")),
    )
    op.create_index(op.f("ix_leftover_item_id"), "leftover", ["item_id"], unique=False)
    op.create_index(op.f("ix_leftover_event_id"), "leftover", ["event_id"], unique=False)
    op.create_table(
        "remeasured_pair",
        sa.Column("remeasurement_id", sa.Uuid(), nullable=False),
        sa.Column("meal_id", sa.Uuid(), nullable=False),
        sa.Column("pair", sa.String(length=16), nullable=False),
        sa.Column("position", sa.Integer(), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("reason", sa.String(length=64), nullable=True),
        sa.Column("job_id", sa.Uuid(), nullable=True),
        sa.Column("ended_at", sa.DateTime(timezone=True), nullable=True),
        sa.CheckConstraint(
            "(ended_at IS NULL) = (state IN ('pending', 'queued'))",
            name=op.f("ck_remeasured_pair_ended"),
        ),
        sa.CheckConstraint(
            "(reason IS NULL) = (state NOT IN ('kept', 'skipped'))",
            name=op.f("ck_remeasured_pair_reason"),
        ),
        sa.CheckConstraint("pair IN ('meal', 'after')", name=op.f("ck_remeasured_pair_pair")),
        sa.CheckConstraint(
            "state IN ('pending', 'queued', 'measured', 'kept', 'skipped')",
            name=op.f("ck_remeasured_pair_state"),
        ),
        sa.ForeignKeyConstraint(["job_id"], ["job.id"], name=op.f("fk_remeasured_pair_job_id_job")),
        sa.ForeignKeyConstraint(
            ["meal_id"], ["meal.id"], name=op.f("fk_remeasured_pair_meal_id_meal")
        ),
        sa.ForeignKeyConstraint(
            ["remeasurement_id"],
            ["remeasurement.id"],
            name=op.f("fk_remeasured_pair_remeasurement_id_remeasurement"),
        ),
        sa.PrimaryKeyConstraint(
            "remeasurement_id", "meal_id", "pair", name=op.f("pk_remeasured_pair")
        ),
        sa.UniqueConstraint("job_id", name=op.f("uq_remeasured_pair_job_id")),
    )
    op.create_index(
        op.f("ix_remeasured_pair_meal_id"), "remeasured_pair", ["meal_id"], unique=False
    )
    op.create_index(
        op.f("ix_remeasured_pair_remeasurement_id_position_pair"),
        "remeasured_pair",
        ["remeasurement_id", "position", "pair"],
        unique=False,
    )
    op.create_index(
        "ix_remeasured_pair_open",
        "remeasured_pair",
        ["remeasurement_id", "state", "position"],
        unique=False,
        sqlite_where=sa.text("state IN ('pending', 'queued')"),
        postgresql_where=sa.text("state IN ('pending', 'queued')"),
    )
    op.create_table(
        "remeasured_item",
        sa.Column("remeasurement_id", sa.Uuid(), nullable=False),
        sa.Column("item_id", sa.Uuid(), nullable=False),
        sa.Column("old_volume_ml", sa.Double(), nullable=True),
        sa.Column("old_low_ml", sa.Double(), nullable=True),
        sa.Column("old_high_ml", sa.Double(), nullable=True),
        sa.Column("new_volume_ml", sa.Double(), nullable=True),
        sa.Column("new_low_ml", sa.Double(), nullable=True),
        sa.Column("new_high_ml", sa.Double(), nullable=True),
        sa.Column("old_mass_g", sa.Double(), nullable=True),
        sa.Column("new_mass_g", sa.Double(), nullable=True),
        sa.Column("is_changed", sa.Boolean(), nullable=False),
        sa.ForeignKeyConstraint(
            ["item_id"], ["item.id"], name=op.f("fk_remeasured_item_item_id_item")
        ),
        sa.ForeignKeyConstraint(
            ["remeasurement_id"],
            ["remeasurement.id"],
            name=op.f("fk_remeasured_item_remeasurement_id_remeasurement"),
        ),
        sa.PrimaryKeyConstraint("remeasurement_id", "item_id", name=op.f("pk_remeasured_item")),
    )
    op.create_index(
        op.f("ix_remeasured_item_item_id"), "remeasured_item", ["item_id"], unique=False
    )
    if op.get_bind().dialect.name == "postgresql":
        for name in RUNS:  # doubles do not get smaller, and reading them would take their unpacking
            op.execute(f"ALTER TABLE study_day_sum ALTER COLUMN {name} SET STORAGE EXTERNAL")
    create_triggers(op.get_bind())


def downgrade() -> None:
    drop_triggers(op.get_bind())
    for table in reversed(TABLES):
        op.drop_table(table)
