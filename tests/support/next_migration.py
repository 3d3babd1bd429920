"""The program of the next version, for tests of what a later migration meets: ours and one more step."""

import shutil

import pytest

from app.db import migrate, schema_state

HEAD = schema_state.head_revision()
REVISION = "20991231_next"
STEP = '''
"""a step of the next version"""

import sqlalchemy as sa
from alembic import op

from app.db.migrate import create_triggers

revision = "20991231_next"
down_revision = "{before}"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table("next_thing", sa.Column("id", sa.Integer(), nullable=False), sa.PrimaryKeyConstraint("id"))
    op.create_index("ix_next_thing_id", "next_thing", ["id"])
    for table in ("run", "diary_day"):  # on SQLite both are made anew
        with op.batch_alter_table(table, recreate="auto") as batch:
            batch.add_column(sa.Column("spare", sa.Integer(), nullable=True))
            batch.create_check_constraint("spare", "spare > 0")
    create_triggers(op.get_bind())


def downgrade() -> None:
    for table in ("run", "diary_day"):
        with op.batch_alter_table(table) as batch:
            batch.drop_constraint(op.f("ck_" + table + "_spare"), type_="check")
            batch.drop_column("spare")
    create_triggers(op.get_bind())
    op.drop_table("next_thing")
'''


def write_next_migration(folder):
    """Into a folder of migrations: after the newest of ours."""
    (folder / "versions" / "next.py").write_text(STEP.format(before=HEAD).lstrip())


@pytest.fixture
def next_migration(monkeypatch, tmp_path):
    """Called, it lets this process know one more migration; returns its revision."""

    def add():
        migrations = tmp_path / "next" / "migrations"
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(schema_state.migrations_folder(), migrations, ignore=ignored)
        write_next_migration(migrations)
        for module in (schema_state, migrate):
            monkeypatch.setattr(module, "migrations_folder", lambda: migrations)
        schema_state.revisions.cache_clear()
        return REVISION

    yield add
    monkeypatch.undo()
    schema_state.revisions.cache_clear()
