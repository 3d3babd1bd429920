"""The database's triggers, which act on each change by any client: `create_triggers`.

- `audit_event` is append-only: changes of rows are refused.
- A change that may alter the sums of a participant's day marks that day (DayMark); a change of a participant's first or
  last day marks the affected days of the study (StudyDayMark).

On SQLite a migration that recreates one of these tables (batch_alter_table) drops its triggers, so any migration that
changes one calls `create_triggers` at its end, as the first one does.
"""

from collections.abc import Mapping, Sequence

import sqlalchemy as sa

from app.meals.record_models import HEADLINE_COLUMNS

AUDIT = "audit_event"
DAY = ("participant_id", "local_date", "study_id")
MARKING = {  # table -> the columns whose change may alter a day's sums
    "meal": (*DAY, "origin", "captured_at", "received_at", "details", "status"),
    "effective_record": (*DAY, "meal_id", "status", "origin", "provisional", "left_g", "consumed_g", *HEADLINE_COLUMNS),
    "diary_day": (*DAY, "status", "ate_nothing", "changed_at"),
}
MARK_ALL_DAYS = """
    INSERT INTO day_mark (participant_id, local_date, study_id)
    SELECT participant_id, local_date, study_id FROM (
        SELECT participant_id, local_date, study_id FROM meal
        UNION SELECT participant_id, local_date, study_id FROM diary_day
    ) AS day ORDER BY local_date
"""
# a comparison with NULL selects no day
MARK_STUDY_DAYS = """
    INSERT INTO study_day_mark (study_id, local_date)
    SELECT study_id, local_date FROM day_sum WHERE participant_id = NEW.id AND (
        local_date < OLD.starts_on OR local_date < NEW.starts_on
        OR local_date > {old_day} OR local_date > {new_day}
    );
"""
PARTICIPANT_CHANGES = "UPDATE OF starts_on, withdrawn_at ON participant"

# SQLite has one writer at a time: a marked day need not be marked again.
SQLITE_MARK = """
    INSERT INTO day_mark (participant_id, local_date, study_id)
    SELECT {row}.participant_id, {row}.local_date, {row}.study_id WHERE NOT EXISTS (
        SELECT 1 FROM day_mark WHERE participant_id = {row}.participant_id AND local_date = {row}.local_date
    ){and_condition};
"""
SQLITE_HAS_MOVED = "(OLD.participant_id, OLD.local_date) IS NOT (NEW.participant_id, NEW.local_date)"
SQLITE_REFUSE = f"SELECT RAISE(ABORT, '{AUDIT} is append-only');"

POSTGRES_FUNCTIONS = {
    "refuse_change": "RAISE EXCEPTION '% is append-only', TG_TABLE_NAME;",
    "mark_day": """
        IF TG_OP <> 'INSERT' THEN
            IF TG_OP = 'DELETE' OR (OLD.participant_id, OLD.local_date) <> (NEW.participant_id, NEW.local_date) THEN
                INSERT INTO day_mark (participant_id, local_date, study_id)
                VALUES (OLD.participant_id, OLD.local_date, OLD.study_id);
            END IF;
        END IF;
        IF TG_OP <> 'DELETE' THEN
            INSERT INTO day_mark (participant_id, local_date, study_id)
            VALUES (NEW.participant_id, NEW.local_date, NEW.study_id);
        END IF;
        RETURN NULL;
    """,
    "mark_study_days": MARK_STUDY_DAYS.format(
        old_day="CAST(OLD.withdrawn_at AT TIME ZONE 'UTC' AS DATE)",
        new_day="CAST(NEW.withdrawn_at AT TIME ZONE 'UTC' AS DATE)",
    )
    + "RETURN NULL;",
}


def create_triggers(connection: sa.Connection) -> None:
    """Create all triggers, replacing existing ones. Columns that an older schema lacks are left out."""
    drop_triggers(connection)
    is_sqlite = connection.dialect.name == "sqlite"
    inspector = sa.inspect(connection)
    marking = {table: _present(inspector, table, columns) for table, columns in MARKING.items()}
    if not is_sqlite:
        for name, body in POSTGRES_FUNCTIONS.items():
            _execute(connection, f"CREATE FUNCTION {name}() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN {body} END $$")
    for name, (_, definition) in _triggers(marking, is_sqlite=is_sqlite).items():
        _execute(connection, f"CREATE TRIGGER {name} {definition}")


def drop_triggers(connection: sa.Connection) -> None:
    """Drop all triggers; harmless if they or their tables do not exist."""
    is_sqlite = connection.dialect.name == "sqlite"
    tables = set(sa.inspect(connection).get_table_names())
    for name, (table, _) in _triggers(MARKING, is_sqlite=is_sqlite).items():
        if table in tables:
            _execute(connection, f"DROP TRIGGER IF EXISTS {name}" + ("" if is_sqlite else f" ON {table}"))
    if not is_sqlite:
        for name in POSTGRES_FUNCTIONS:
            _execute(connection, f"DROP FUNCTION IF EXISTS {name}()")


def _present(inspector: sa.Inspector, table: str, columns: Sequence[str]) -> list[str]:
    existing = {column["name"] for column in inspector.get_columns(table)}
    return [name for name in columns if name in existing]


def _triggers(marking: Mapping[str, Sequence[str]], *, is_sqlite: bool) -> dict[str, tuple[str, str]]:
    """Return name -> (table, definition that follows the name in CREATE TRIGGER)."""
    return _sqlite_triggers(marking) if is_sqlite else _postgres_triggers(marking)


def _sqlite_triggers(marking: Mapping[str, Sequence[str]]) -> dict[str, tuple[str, str]]:
    triggers = {
        f"{AUDIT}_no_{verb.lower()}": (AUDIT, f"BEFORE {verb} ON {AUDIT} BEGIN {SQLITE_REFUSE} END")
        for verb in ("UPDATE", "DELETE")
    }
    # INSERT OR REPLACE fires DELETE triggers only if its connection sets recursive_triggers
    is_there = f"WHEN EXISTS (SELECT 1 FROM {AUDIT} WHERE id = NEW.id)"  # noqa: S608  # our own names
    triggers[f"{AUDIT}_no_replace"] = (AUDIT, f"BEFORE INSERT ON {AUDIT} {is_there} BEGIN {SQLITE_REFUSE} END")
    new, old = (SQLITE_MARK.format(row=row, and_condition="") for row in ("NEW", "OLD"))
    moved = SQLITE_MARK.format(row="OLD", and_condition=f" AND {SQLITE_HAS_MOVED}")
    for table, columns in marking.items():
        bodies = {"INSERT": new, f"UPDATE OF {', '.join(columns)}": new + moved, "DELETE": old}
        for event, body in bodies.items():
            name = f"{table}_marks_day_{event.partition(' ')[0].lower()}"
            triggers[name] = (table, f"AFTER {event} ON {table} BEGIN {body} END")
    mark = MARK_STUDY_DAYS.format(old_day="date(OLD.withdrawn_at)", new_day="date(NEW.withdrawn_at)")
    triggers["participant_marks_study_days"] = ("participant", f"AFTER {PARTICIPANT_CHANGES} BEGIN {mark} END")
    return triggers


def _postgres_triggers(marking: Mapping[str, Sequence[str]]) -> dict[str, tuple[str, str]]:
    triggers = {}
    for table, columns in marking.items():
        event = f"INSERT OR DELETE OR UPDATE OF {', '.join(columns)}"
        triggers[f"{table}_marks_day"] = (table, f"AFTER {event} ON {table} FOR EACH ROW EXECUTE FUNCTION mark_day()")
    refused = f"BEFORE UPDATE OR DELETE OR TRUNCATE ON {AUDIT} FOR EACH STATEMENT EXECUTE FUNCTION refuse_change()"
    triggers[f"{AUDIT}_no_change"] = (AUDIT, refused)
    marks = f"AFTER {PARTICIPANT_CHANGES} FOR EACH ROW EXECUTE FUNCTION mark_study_days()"
    triggers["participant_marks_study_days"] = ("participant", marks)
    return triggers


def _execute(connection: sa.Connection, statement: str) -> None:
    connection.exec_driver_sql(statement.replace("%", "%%") if connection.dialect.name == "postgresql" else statement)
