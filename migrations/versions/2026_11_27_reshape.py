"""events of the kind `reshape`

Revision ID: 20261127_reshape
Revises: 20261124_baseline
Create Date: 2026-11-27 01:00:00
"""

from alembic import op

revision = "20261127_reshape"
down_revision = "20261124_baseline"
branch_labels = None
depends_on = None

KINDS = (
    "'confirm', 'reject', 'set_food', 'set_volume', 'set_mass', 'set_share', 'set_leftover', 'add', 'declare', "
    "'split', 'merge', 'redraw', {}'nothing_left', 'confirm_meal', 'comment', 'question', 'answer', 'undo'"
)


def upgrade() -> None:
    replace_check(KINDS.format("'reshape', "))


def downgrade() -> None:
    """An event of the kind is kept as the volume that it set."""
    op.execute("UPDATE meal_event SET kind = 'set_volume' WHERE kind = 'reshape'")
    replace_check(KINDS.format(""))


def replace_check(kinds: str) -> None:
    with op.batch_alter_table("meal_event") as batch:
        batch.drop_constraint(op.f("ck_meal_event_kind"), type_="check")
        batch.create_check_constraint(op.f("ck_meal_event_kind"), f"kind IN ({kinds})")
