"""voice notes among a meal's images

The older schema has no place for them: the way back fails while there are any.

Revision ID: 20261127_voice_notes
Revises: 20261127_sandbox
Create Date: 2026-11-27 16:40:00
"""

import sqlalchemy as sa
from alembic import op

from app.core.errors import ConflictError

revision = "20261127_voice_notes"
down_revision = "20261127_sandbox"
branch_labels = None
depends_on = None

VIEWS = ("left", "right", *(f"view{number}" for number in range(3, 9)))
MAPS = ("left_depth", "right_depth", "left_confidence", "right_confidence")
IMAGES = (*VIEWS, *MAPS, "after_left", "after_right")
NOTE = "voice_note"


def upgrade() -> None:
    _allow((*IMAGES, NOTE))


def downgrade() -> None:
    images = sa.table("meal_image", sa.column("slot"))
    count = op.get_bind().scalar(
        sa.select(sa.func.count()).select_from(images).where(images.c.slot == NOTE)
    )
    if count:
        raise ConflictError(
            f"The schema cannot go back behind {revision}: the older one has no place for voice notes ({count}). "
            "Nothing was changed; a restore of a backup is the way back."
        )
    _allow(IMAGES)


def _allow(slots: tuple[str, ...]) -> None:
    listed = ", ".join(f"'{slot}'" for slot in slots)
    with op.batch_alter_table("meal_image") as batch:
        batch.drop_constraint(op.f("ck_meal_image_slot"), type_="check")
        batch.create_check_constraint(op.f("ck_meal_image_slot"), f"slot IN ({listed})")
