"""depth and confidence maps among a meal's images

The older schema has no place for them: the way back fails while there are any.

Revision ID: 20261127_depth_maps
Revises: 20261127_rigs
Create Date: 2026-11-27 01:40:00
"""

import sqlalchemy as sa
from alembic import op

from app.core.errors import ConflictError

revision = "20261127_depth_maps"
down_revision = "20261127_rigs"
branch_labels = None
depends_on = None

PHOTOGRAPHS = ("left", "right", *(f"view{number}" for number in range(3, 9)))
AFTER = ("after_left", "after_right")
MAPS = ("left_depth", "right_depth", "left_confidence", "right_confidence")


def upgrade() -> None:
    _allow((*PHOTOGRAPHS, *MAPS, *AFTER))


def downgrade() -> None:
    images = sa.table("meal_image", sa.column("slot"))
    count = op.get_bind().scalar(
        sa.select(sa.func.count()).select_from(images).where(images.c.slot.in_(MAPS))
    )
    if count:
        raise ConflictError(
            f"The schema cannot go back behind {revision}: the older one has no place for depth maps ({count}). "
            "Nothing was changed; a restore of a backup is the way back."
        )
    _allow((*PHOTOGRAPHS, *AFTER))


def _allow(slots: tuple[str, ...]) -> None:
    listed = ", ".join(f"'{slot}'" for slot in slots)
    with op.batch_alter_table("meal_image") as batch:
        batch.drop_constraint(op.f("ck_meal_image_slot"), type_="check")
        batch.create_check_constraint(op.f("ck_meal_image_slot"), f"slot IN ({listed})")
