"""first tables

Revision ID: 20261121_first
Revises:
Create Date: 2026-11-21 05:39:05.146261
"""

import sqlalchemy as sa
from alembic import op
from sqlalchemy.dialects import postgresql

revision = "20261121_first"
down_revision = None
INSTANT = sa.DateTime(timezone=True)
JSON_VALUE = sa.JSON(none_as_null=True).with_variant(postgresql.JSONB(none_as_null=True), "postgresql")

branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "component",
        sa.Column("tagname", sa.String(length=16), nullable=False),
        sa.Column("name", sa.String(length=100), nullable=False),
        sa.Column("unit", sa.String(length=8), nullable=False),
        sa.PrimaryKeyConstraint("tagname", name=op.f("pk_component")),
    )
    op.create_table(
        "food_release",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(length=100), nullable=False),
        sa.Column("version", sa.String(length=32), nullable=False),
        sa.Column("released_on", sa.Date(), nullable=False),
        sa.Column("checksum", sa.String(length=64), nullable=False),
        sa.Column("imported_at", INSTANT, nullable=False),
        sa.Column("is_active", sa.Boolean(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_food_release")),
        sa.UniqueConstraint("checksum", name=op.f("uq_food_release_checksum")),
    )
    op.create_table(
        "staff",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("is_admin", sa.Boolean(), nullable=False),
        sa.Column("created_at", INSTANT, nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_staff")),
        sa.UniqueConstraint("name", name=op.f("uq_staff_name")),
    )
    op.create_table(
        "study",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("code", sa.String(length=64), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("marker", sa.String(length=64), nullable=True),
        sa.Column("location_policy", sa.String(length=16), nullable=False),
        sa.Column("change_seq", sa.BigInteger(), nullable=False),
        sa.Column("created_at", INSTANT, nullable=False),
        sa.CheckConstraint("location_policy IN ('drop', 'keep')", name=op.f("ck_study_location_policy")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_study")),
        sa.UniqueConstraint("code", name=op.f("uq_study_code")),
    )
    op.create_table(
        "worker_lease",
        sa.Column("executor_id", sa.String(length=64), nullable=False),
        sa.Column("host", sa.String(length=255), nullable=False),
        sa.Column("pid", sa.Integer(), nullable=False),
        sa.Column("version", sa.String(length=32), nullable=False),
        sa.Column("started_at", INSTANT, nullable=False),
        sa.Column("heartbeat_at", INSTANT, nullable=False),
        sa.PrimaryKeyConstraint("executor_id", name=op.f("pk_worker_lease")),
    )
    op.create_table(
        "food",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("release_id", sa.Integer(), nullable=False),
        sa.Column("key", sa.String(length=100), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("aliases", JSON_VALUE, nullable=False),
        sa.Column("food_group", sa.String(length=100), nullable=False),
        sa.Column("form", sa.String(length=16), nullable=False),
        sa.Column("slice_form", sa.String(length=16), nullable=True),
        sa.Column("refuse", JSON_VALUE, nullable=False),
        sa.Column("source_ids", JSON_VALUE, nullable=False),
        sa.ForeignKeyConstraint(["release_id"], ["food_release.id"], name=op.f("fk_food_release_id_food_release")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_food")),
        sa.UniqueConstraint("release_id", "key", name=op.f("uq_food_release_id_key")),
    )
    op.create_table(
        "participant",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("code", sa.String(length=64), nullable=False),
        sa.Column("created_at", INSTANT, nullable=False),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_participant_study_id_study")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_participant")),
        sa.UniqueConstraint("study_id", "code", name=op.f("uq_participant_study_id_code")),
    )
    op.create_table(
        "device",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("participant_id", sa.Uuid(), nullable=False),
        sa.Column("name", sa.String(length=200), nullable=False),
        sa.Column("enrolled_at", INSTANT, nullable=False),
        sa.ForeignKeyConstraint(
            ["participant_id"], ["participant.id"], name=op.f("fk_device_participant_id_participant")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_device")),
    )
    with op.batch_alter_table("device", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_device_participant_id"), ["participant_id"], unique=False)

    op.create_table(
        "enrolment",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("participant_id", sa.Uuid(), nullable=False),
        sa.Column("code_sha256", sa.String(length=64), nullable=False),
        sa.Column("expires_at", INSTANT, nullable=False),
        sa.Column("used_at", INSTANT, nullable=True),
        sa.Column("created_at", INSTANT, nullable=False),
        sa.ForeignKeyConstraint(
            ["participant_id"], ["participant.id"], name=op.f("fk_enrolment_participant_id_participant")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_enrolment")),
        sa.UniqueConstraint("code_sha256", name=op.f("uq_enrolment_code_sha256")),
    )
    with op.batch_alter_table("enrolment", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_enrolment_participant_id"), ["participant_id"], unique=False)

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
        sa.CheckConstraint("kind IN ('solid', 'bulk')", name=op.f("ck_food_density_kind")),
        sa.CheckConstraint("g_per_ml > 0", name=op.f("ck_food_density_positive")),
        sa.ForeignKeyConstraint(["food_id"], ["food.id"], name=op.f("fk_food_density_food_id_food")),
        sa.PrimaryKeyConstraint("food_id", "position", name=op.f("pk_food_density")),
    )
    op.create_table(
        "food_nutrient",
        sa.Column("food_id", sa.Integer(), nullable=False),
        sa.Column("tagname", sa.String(length=16), nullable=False),
        sa.Column("per_100_g", sa.Double(), nullable=False),
        sa.ForeignKeyConstraint(["food_id"], ["food.id"], name=op.f("fk_food_nutrient_food_id_food")),
        sa.ForeignKeyConstraint(["tagname"], ["component.tagname"], name=op.f("fk_food_nutrient_tagname_component")),
        sa.PrimaryKeyConstraint("food_id", "tagname", name=op.f("pk_food_nutrient")),
    )
    op.create_table(
        "access_token",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("token_sha256", sa.String(length=64), nullable=False),
        sa.Column("device_id", sa.Uuid(), nullable=True),
        sa.Column("staff_id", sa.Uuid(), nullable=True),
        sa.Column("created_at", INSTANT, nullable=False),
        sa.Column("expires_at", INSTANT, nullable=True),
        sa.Column("revoked_at", INSTANT, nullable=True),
        sa.CheckConstraint("(device_id IS NULL) <> (staff_id IS NULL)", name=op.f("ck_access_token_one_owner")),
        sa.ForeignKeyConstraint(["device_id"], ["device.id"], name=op.f("fk_access_token_device_id_device")),
        sa.ForeignKeyConstraint(["staff_id"], ["staff.id"], name=op.f("fk_access_token_staff_id_staff")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_access_token")),
        sa.UniqueConstraint("token_sha256", name=op.f("uq_access_token_token_sha256")),
    )
    with op.batch_alter_table("access_token", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_access_token_device_id"), ["device_id"], unique=False)
        batch_op.create_index(batch_op.f("ix_access_token_staff_id"), ["staff_id"], unique=False)

    op.create_table(
        "meal",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("client_id", sa.Uuid(), nullable=False),
        sa.Column("study_id", sa.Uuid(), nullable=False),
        sa.Column("participant_id", sa.Uuid(), nullable=False),
        sa.Column("device_id", sa.Uuid(), nullable=False),
        sa.Column("captured_at", INSTANT, nullable=False),
        sa.Column("utc_offset_minutes", sa.Integer(), nullable=False),
        sa.Column("time_zone", sa.String(length=64), nullable=False),
        sa.Column("local_date", sa.Date(), nullable=False),
        sa.Column("details", JSON_VALUE, nullable=False),
        sa.Column("status", sa.String(length=16), nullable=False),
        sa.Column("stage", sa.String(length=32), nullable=True),
        sa.Column("failure_code", sa.String(length=64), nullable=True),
        sa.Column("failure_message", sa.Text(), nullable=True),
        sa.Column("failure_advice", sa.Text(), nullable=True),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("received_at", INSTANT, nullable=False),
        sa.Column("submitted_at", INSTANT, nullable=True),
        sa.Column("deleted_at", INSTANT, nullable=True),
        sa.CheckConstraint(
            "status IN ('receiving', 'queued', 'processing', 'estimated', 'needs_review', 'failed', 'confirmed')",
            name=op.f("ck_meal_status"),
        ),
        sa.ForeignKeyConstraint(["device_id"], ["device.id"], name=op.f("fk_meal_device_id_device")),
        sa.ForeignKeyConstraint(
            ["participant_id"], ["participant.id"], name=op.f("fk_meal_participant_id_participant")
        ),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_meal_study_id_study")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_meal")),
        sa.UniqueConstraint("participant_id", "client_id", name=op.f("uq_meal_participant_id_client_id")),
    )
    with op.batch_alter_table("meal", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_meal_status_submitted_at"), ["status", "submitted_at"], unique=False)
        batch_op.create_index(
            batch_op.f("ix_meal_study_id_captured_at_id"), ["study_id", "captured_at", "id"], unique=False
        )

    op.create_table(
        "job",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("meal_id", sa.Uuid(), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("attempts", sa.Integer(), nullable=False),
        sa.Column("executor_id", sa.String(length=64), nullable=True),
        sa.Column("enqueued_at", INSTANT, nullable=False),
        sa.Column("started_at", INSTANT, nullable=True),
        sa.Column("finished_at", INSTANT, nullable=True),
        sa.CheckConstraint("state IN ('queued', 'processing', 'done', 'failed')", name=op.f("ck_job_state")),
        sa.ForeignKeyConstraint(["meal_id"], ["meal.id"], name=op.f("fk_job_meal_id_meal")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_job")),
    )
    with op.batch_alter_table("job", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_job_meal_id"), ["meal_id"], unique=False)
        batch_op.create_index(batch_op.f("ix_job_state_enqueued_at"), ["state", "enqueued_at"], unique=False)

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
        sa.Column("received_at", INSTANT, nullable=False),
        sa.CheckConstraint("slot IN ('left', 'right')", name=op.f("ck_meal_image_slot")),
        sa.ForeignKeyConstraint(["meal_id"], ["meal.id"], name=op.f("fk_meal_image_meal_id_meal")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_meal_image")),
        sa.UniqueConstraint("blob_key", name=op.f("uq_meal_image_blob_key")),
        sa.UniqueConstraint("meal_id", "slot", name=op.f("uq_meal_image_meal_id_slot")),
    )
    op.create_table(
        "run",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("meal_id", sa.Uuid(), nullable=False),
        sa.Column("method", sa.String(length=32), nullable=False),
        sa.Column("pipeline_version", sa.String(length=32), nullable=False),
        sa.Column("marker", sa.String(length=64), nullable=False),
        sa.Column("camera", JSON_VALUE, nullable=True),
        sa.Column("parameters", JSON_VALUE, nullable=False),
        sa.Column("stages", JSON_VALUE, nullable=False),
        sa.Column("seconds", sa.Double(), nullable=False),
        sa.Column("food_release_id", sa.Integer(), nullable=True),
        sa.Column("failure_code", sa.String(length=64), nullable=True),
        sa.Column("failure_message", sa.Text(), nullable=True),
        sa.Column("result_key", sa.String(length=300), nullable=False),
        sa.Column("created_at", INSTANT, nullable=False),
        sa.ForeignKeyConstraint(
            ["food_release_id"], ["food_release.id"], name=op.f("fk_run_food_release_id_food_release")
        ),
        sa.ForeignKeyConstraint(["id"], ["job.id"], name=op.f("fk_run_id_job")),
        sa.ForeignKeyConstraint(["meal_id"], ["meal.id"], name=op.f("fk_run_meal_id_meal")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_run")),
        sa.UniqueConstraint("result_key", name=op.f("uq_run_result_key")),
    )
    with op.batch_alter_table("run", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_run_meal_id"), ["meal_id"], unique=False)

    op.create_table(
        "item",
        sa.Column("id", sa.Uuid(), nullable=False),
        sa.Column("run_id", sa.Uuid(), nullable=False),
        sa.Column("position", sa.Integer(), nullable=False),
        sa.Column("rings", JSON_VALUE, nullable=False),
        sa.Column("volume_ml", sa.Double(), nullable=False),
        sa.Column("volume_low_ml", sa.Double(), nullable=False),
        sa.Column("volume_high_ml", sa.Double(), nullable=False),
        sa.Column("relative_sd", JSON_VALUE, nullable=False),
        sa.Column("flags", JSON_VALUE, nullable=False),
        sa.ForeignKeyConstraint(["run_id"], ["run.id"], name=op.f("fk_item_run_id_run")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_item")),
        sa.UniqueConstraint("run_id", "position", name=op.f("uq_item_run_id_position")),
    )
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
        sa.Column("captured_at", INSTANT, nullable=False),
        sa.Column("local_date", sa.Date(), nullable=False),
        sa.Column("status", sa.String(length=16), nullable=False),
        sa.Column("food_id", sa.Integer(), nullable=True),
        sa.Column("volume_ml", sa.Double(), nullable=False),
        sa.Column("volume_low_ml", sa.Double(), nullable=False),
        sa.Column("volume_high_ml", sa.Double(), nullable=False),
        sa.Column("density_g_per_ml", sa.Double(), nullable=True),
        sa.Column("density_source", sa.String(length=300), nullable=True),
        sa.Column("mass_g", sa.Double(), nullable=True),
        sa.Column("mass_low_g", sa.Double(), nullable=True),
        sa.Column("mass_high_g", sa.Double(), nullable=True),
        sa.Column("edible_g", sa.Double(), nullable=True),
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
        sa.Column("change_seq", sa.BigInteger(), nullable=False),
        sa.CheckConstraint(
            "status IN ('proposed', 'needs_review', 'confirmed', 'corrected', 'rejected')",
            name=op.f("ck_effective_record_status"),
        ),
        sa.ForeignKeyConstraint(["food_id"], ["food.id"], name=op.f("fk_effective_record_food_id_food")),
        sa.ForeignKeyConstraint(["item_id"], ["item.id"], name=op.f("fk_effective_record_item_id_item")),
        sa.ForeignKeyConstraint(["meal_id"], ["meal.id"], name=op.f("fk_effective_record_meal_id_meal")),
        sa.ForeignKeyConstraint(
            ["participant_id"], ["participant.id"], name=op.f("fk_effective_record_participant_id_participant")
        ),
        sa.ForeignKeyConstraint(["study_id"], ["study.id"], name=op.f("fk_effective_record_study_id_study")),
        sa.PrimaryKeyConstraint("item_id", name=op.f("pk_effective_record")),
    )
    with op.batch_alter_table("effective_record", schema=None) as batch_op:
        batch_op.create_index(
            batch_op.f("ix_effective_record_captured_at_item_id"), ["captured_at", "item_id"], unique=False
        )
        batch_op.create_index(batch_op.f("ix_effective_record_meal_id"), ["meal_id"], unique=False)
        batch_op.create_index(
            batch_op.f("ix_effective_record_participant_id_captured_at_item_id"),
            ["participant_id", "captured_at", "item_id"],
            unique=False,
        )
        batch_op.create_index(
            batch_op.f("ix_effective_record_study_id_captured_at_item_id"),
            ["study_id", "captured_at", "item_id"],
            unique=False,
        )
        batch_op.create_index(
            batch_op.f("ix_effective_record_study_id_change_seq"), ["study_id", "change_seq"], unique=False
        )

    op.create_table(
        "item_candidate",
        sa.Column("item_id", sa.Uuid(), nullable=False),
        sa.Column("position", sa.Integer(), nullable=False),
        sa.Column("food_id", sa.Integer(), nullable=False),
        sa.Column("probability", sa.Double(), nullable=True),
        sa.Column("source", sa.String(length=16), nullable=False),
        sa.ForeignKeyConstraint(["food_id"], ["food.id"], name=op.f("fk_item_candidate_food_id_food")),
        sa.ForeignKeyConstraint(["item_id"], ["item.id"], name=op.f("fk_item_candidate_item_id_item")),
        sa.PrimaryKeyConstraint("item_id", "position", name=op.f("pk_item_candidate")),
    )


def downgrade() -> None:
    op.drop_table("item_candidate")
    with op.batch_alter_table("effective_record", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f("ix_effective_record_study_id_change_seq"))
        batch_op.drop_index(batch_op.f("ix_effective_record_study_id_captured_at_item_id"))
        batch_op.drop_index(batch_op.f("ix_effective_record_participant_id_captured_at_item_id"))
        batch_op.drop_index(batch_op.f("ix_effective_record_meal_id"))
        batch_op.drop_index(batch_op.f("ix_effective_record_captured_at_item_id"))

    op.drop_table("effective_record")
    op.drop_table("run_artefact")
    op.drop_table("item")
    with op.batch_alter_table("run", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f("ix_run_meal_id"))

    op.drop_table("run")
    op.drop_table("meal_image")
    with op.batch_alter_table("job", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f("ix_job_state_enqueued_at"))
        batch_op.drop_index(batch_op.f("ix_job_meal_id"))

    op.drop_table("job")
    with op.batch_alter_table("meal", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f("ix_meal_study_id_captured_at_id"))
        batch_op.drop_index(batch_op.f("ix_meal_status_submitted_at"))

    op.drop_table("meal")
    with op.batch_alter_table("access_token", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f("ix_access_token_staff_id"))
        batch_op.drop_index(batch_op.f("ix_access_token_device_id"))

    op.drop_table("access_token")
    op.drop_table("food_nutrient")
    op.drop_table("food_density")
    with op.batch_alter_table("enrolment", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f("ix_enrolment_participant_id"))

    op.drop_table("enrolment")
    with op.batch_alter_table("device", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f("ix_device_participant_id"))

    op.drop_table("device")
    op.drop_table("participant")
    op.drop_table("food")
    op.drop_table("worker_lease")
    op.drop_table("study")
    op.drop_table("staff")
    op.drop_table("food_release")
    op.drop_table("component")
