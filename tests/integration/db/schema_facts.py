"""What a database's schema holds, as facts that two schemas are compared by; order and spelling left out.

Beyond what Alembic's comparison sees: server defaults, checks by their text, what references do on delete, the columns,
uniqueness and conditions of indexes.
"""

import re

import sqlalchemy as sa

from app.db.base import Base

POSTGRES_FACTS = """
    SELECT c.relname, 'column', a.attname, format_type(a.atttypid, a.atttypmod)
        || CASE WHEN a.attidentity <> '' THEN ' identity ' || a.attidentity::text ELSE '' END
        || CASE WHEN a.attnotnull THEN ' not null' ELSE '' END
        || coalesce(' default ' || pg_get_expr(d.adbin, d.adrelid), '')
    FROM pg_attribute a JOIN pg_class c ON c.oid = a.attrelid
        LEFT JOIN pg_attrdef d ON (d.adrelid, d.adnum) = (a.attrelid, a.attnum)
    WHERE c.relnamespace = 'public'::regnamespace AND c.relkind = 'r' AND a.attnum > 0 AND NOT a.attisdropped
    UNION ALL
    SELECT c.relname, 'constraint', o.conname, pg_get_constraintdef(o.oid)
    FROM pg_constraint o JOIN pg_class c ON c.oid = o.conrelid
    WHERE c.relnamespace = 'public'::regnamespace AND o.contype <> 'n'
    UNION ALL
    SELECT tablename, 'index', indexname, indexdef FROM pg_indexes WHERE schemaname = 'public'
"""  # 'n', of newer servers: NOT NULL told twice


def facts_of(connection):
    """(table, what, name) -> its definition, of our own tables."""
    read = _sqlite_facts if connection.dialect.name == "sqlite" else _postgres_facts
    return {key: text for key, text in read(connection).items() if key[0] in Base.metadata.tables}


def _postgres_facts(connection):
    return {(table, what, name): text for table, what, name, text in connection.execute(sa.text(POSTGRES_FACTS))}


def _sqlite_facts(connection):
    inspector, found = sa.inspect(connection), {}
    for table in inspector.get_table_names():
        for _, name, kind, is_needed, default, place in connection.exec_driver_sql(f"PRAGMA table_info({table})"):
            needed = " not null" if is_needed else ""
            told = f" default {default}" if default is not None else ""
            found[table, "column", name] = f"{kind}{' primary key ' + str(place) if place else ''}{needed}{told}"
        for check in inspector.get_check_constraints(table):
            found[table, "constraint", check["name"]] = plain(check["sqltext"])
        for key in inspector.get_foreign_keys(table):
            found[table, "constraint", key["name"]] = (
                f"{key['constrained_columns']} -> {key['referred_table']}{key['referred_columns']} {key['options']}"
            )
        for unique in inspector.get_unique_constraints(table):
            found[table, "constraint", unique["name"]] = f"unique {unique['column_names']}"
        for name, text in connection.exec_driver_sql(
            "SELECT name, sql FROM sqlite_master WHERE type = 'index' AND tbl_name = ? AND sql IS NOT NULL", (table,)
        ):
            found[table, "index", name] = plain(text)
    return found


def plain(text):
    """SQL without quotes, line ends and doubled blanks, in small letters."""
    return re.sub(r"\s+", " ", text.replace('"', "")).strip().lower()
