"""The database's triggers: `audit_event` is append-only, by any client."""

import sqlalchemy as sa

AUDIT = "audit_event"
SQLITE_REFUSE = f"SELECT RAISE(ABORT, '{AUDIT} is append-only');"
SQLITE_TRIGGERS = {
    f"{AUDIT}_no_update": f"BEFORE UPDATE ON {AUDIT}",
    f"{AUDIT}_no_delete": f"BEFORE DELETE ON {AUDIT}",
    # INSERT OR REPLACE fires DELETE triggers only if its connection sets recursive_triggers
    f"{AUDIT}_no_replace": (
        f"BEFORE INSERT ON {AUDIT} WHEN EXISTS (SELECT 1 FROM {AUDIT} WHERE id = NEW.id)"  # noqa: S608  # our own names
    ),
}
POSTGRES_TRIGGER = f"{AUDIT}_no_change"
POSTGRES_EVENT = f"BEFORE UPDATE OR DELETE OR TRUNCATE ON {AUDIT} FOR EACH STATEMENT"
POSTGRES_REFUSE = """
    CREATE FUNCTION refuse_change() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN
        RAISE EXCEPTION '% is append-only', TG_TABLE_NAME;
    END $$
"""


def create_triggers(connection: sa.Connection) -> None:
    """Create all triggers, replacing existing ones."""
    drop_triggers(connection)
    if connection.dialect.name == "sqlite":
        for name, event in SQLITE_TRIGGERS.items():
            connection.exec_driver_sql(f"CREATE TRIGGER {name} {event} BEGIN {SQLITE_REFUSE} END")
        return
    connection.exec_driver_sql(POSTGRES_REFUSE.replace("%", "%%"))
    connection.exec_driver_sql(
        f"CREATE TRIGGER {POSTGRES_TRIGGER} {POSTGRES_EVENT} EXECUTE FUNCTION refuse_change()"
    )


def drop_triggers(connection: sa.Connection) -> None:
    """Drop all triggers; harmless if they or their table do not exist."""
    if AUDIT not in sa.inspect(connection).get_table_names():
        return
    if connection.dialect.name == "sqlite":
        for name in SQLITE_TRIGGERS:
            connection.exec_driver_sql(f"DROP TRIGGER IF EXISTS {name}")
        return
    connection.exec_driver_sql(f"DROP TRIGGER IF EXISTS {POSTGRES_TRIGGER} ON {AUDIT}")
    connection.exec_driver_sql("DROP FUNCTION IF EXISTS refuse_change()")
