"""the last backup, found in the audit log at once, however much has happened since

An index that is there already is kept: who runs a large PostgreSQL makes it beforehand, while meals come in:
CREATE INDEX CONCURRENTLY ix_audit_event_last_backup ON audit_event (id) WHERE action = 'backup.make'.

Revision ID: 20261122_last_backup
Revises: 20261122_record_indexes
Create Date: 2026-11-22 03:25:00
"""

import sqlalchemy as sa
from alembic import op

revision = "20261122_last_backup"
down_revision = "20261122_record_indexes"
branch_labels = None
depends_on = None

NAME = "ix_audit_event_last_backup"
OF_BACKUPS = sa.text("action = 'backup.make'")


def upgrade() -> None:
    if op.get_bind().dialect.name == "postgresql":
        drop_unfinished()
    op.create_index(
        op.f(NAME), "audit_event", ["id"], postgresql_where=OF_BACKUPS, sqlite_where=OF_BACKUPS, if_not_exists=True
    )


def downgrade() -> None:
    op.drop_index(op.f(NAME), table_name="audit_event")


def drop_unfinished() -> None:
    """An index whose CREATE INDEX CONCURRENTLY was broken off has its name, and serves no query."""
    unfinished = sa.text("SELECT 1 FROM pg_index WHERE indexrelid = to_regclass(:name) AND NOT indisvalid")
    if op.get_bind().execute(unfinished, {"name": NAME}).first() is not None:
        op.drop_index(NAME)
