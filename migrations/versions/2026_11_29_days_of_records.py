"""an index of records that has all that a day sums

Revision ID: 20261129_days_of_records
Revises: 20261129_sign_in_attempts
Create Date: 2026-11-29 14:30:00
"""

from alembic import op

revision = "20261129_days_of_records"
down_revision = "20261129_sign_in_attempts"
branch_labels = None
depends_on = None

NAME = "ix_effective_record_days"
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
COLUMNS = ("participant_id", "local_date", "status", "provisional", "consumed_g", *HEADLINES)


def upgrade() -> None:
    op.create_index(NAME, "effective_record", COLUMNS)


def downgrade() -> None:
    op.drop_index(NAME, "effective_record")
