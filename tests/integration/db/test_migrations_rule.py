"""The rule of docs/development.md: old code works on the new schema while machines are upgraded one by one.

So no migration takes away, renames or demands what the version before does not know, unless it says in CONTRACTS which
release stopped using it.
"""

import re

import pytest
import sqlalchemy as sa
from alembic.script import ScriptDirectory

from app.db.migrate import upgrade
from app.db.schema_state import migrations_folder, revisions
from app.db.session import Database
from tests.integration.db.schema_facts import facts_of


def what_old_code_would_miss(before, after):
    """What the version before relies on and the step takes away, or demands though that version does not give it."""
    found = []
    for (table, what, name), text in before.items():
        now = after.get((table, what, name))
        if what == "column" and now is None:
            found.append(f"{table}.{name} is gone")
        elif what == "column" and type_of(now) != type_of(text):
            found.append(f"{table}.{name} was {text}, is {now}")
        elif what == "column" and " not null" in now and " not null" not in text:
            found.append(f"{table}.{name} may not be null any more")
        elif what == "index" and now is None:
            found.append(f"{table}: index {name} is gone, which old code needs")
    old_tables = {table for table, _, _ in before}
    for (table, what, name), text in after.items():
        if table not in old_tables or (table, what, name) in before:
            continue
        if what == "column" and " not null" in text and not has_default(text):
            found.append(f"{table}.{name} is new and has no default")
        elif what != "column" and binds(what, text) and not is_of_new_columns(before, after, table, text):
            found.append(f"{table}: {name} binds rows that old code writes")
    return found


def binds(what, text):
    return "unique" in text.lower() or (what == "constraint" and not refers(text))


def is_of_new_columns(before, after, table, text):
    """Old code writes NULL in all its columns, and rows of NULL are never the same."""
    columns = [(table, "column", name) for name in text.rpartition("(")[2].rstrip(")").split(", ")]
    return all(column not in before and " not null" not in after.get(column, " not null") for column in columns)


def has_default(column):
    return " default " in column and not column.endswith(" default NULL")


def type_of(column):
    return column.partition(" default ")[0].removesuffix(" not null")


def refers(constraint):
    """A foreign key: it may stand on a column that is new."""
    return "FOREIGN KEY" in constraint or "->" in constraint


def contracts_of(revision):
    """The release that stopped using what this migration takes away; None: it takes nothing away."""
    script = ScriptDirectory(str(migrations_folder())).get_revision(revision)
    return getattr(script.module, "CONTRACTS", None)


def test_old_code_can_work_on_the_schema_of_each_later_step(database_url):
    database, steps = Database(database_url), revisions()
    try:
        upgrade(database, steps[0])
        before = facts(database)
        for revision in steps[1:]:
            upgrade(database, revision)
            after = facts(database)
            missed = what_old_code_would_miss(before, after)
            assert not missed or re.fullmatch(r"\d+\.\d+\.\d+", contracts_of(revision) or ""), (
                f"{revision}: {missed}. See docs/development.md: stop using it in one release, take it away later, "
                'and name the first in the migration: CONTRACTS = "1.2.0"'
            )
            before = after
    finally:
        database.dispose()


BREAKS = {
    "ALTER TABLE study DROP COLUMN shares_index": "study.shares_index is gone",
    "ALTER TABLE run RENAME COLUMN colour TO color": "run.colour is gone",
    "ALTER TABLE study ADD COLUMN spare INTEGER NOT NULL": "study.spare is new and has no default",
    "DROP INDEX ix_meal_status_submitted_at": "meal: index ix_meal_status_submitted_at is gone, which old code needs",
    "CREATE UNIQUE INDEX uq_spare ON device (name)": "device: uq_spare binds rows that old code writes",
}


@pytest.mark.both_stores
def test_change_that_breaks_old_code_is_found(database):
    before = facts(database)
    with database.write_engine.begin() as connection:
        for change in BREAKS:
            default = " DEFAULT NULL" if database.is_sqlite and "NOT NULL" in change else ""  # which it asks for
            connection.execute(sa.text(change + default))
    assert sorted(what_old_code_would_miss(before, facts(database))) == sorted(BREAKS.values())


def facts(database):
    with database.read_engine.connect() as connection:
        return facts_of(connection)
