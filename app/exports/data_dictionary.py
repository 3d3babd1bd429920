"""The data dictionary of a table as it would be exported now; `all` components are those of the foods in use."""

from collections.abc import Mapping

from app.db.session import Database
from app.exports.export_spec import ExportSpec, Rows, check_spec
from app.exports.tables.export_tables import table_of
from app.http.tables.columns import Column, columns_of
from app.people.access.caller import Caller

KEYS: Mapping[Rows, tuple[str, ...]] = {  # columns that identify a row
    "items": ("id",),
    "meals": ("study", "participant", "meal_id"),
    "days": ("study", "participant", "local_date"),
    "photographs": ("study", "participant", "meal_id", "slot"),
    "participants": ("study", "participant"),
}


def columns_for(database: Database, caller: Caller, spec: ExportSpec) -> tuple[Column, ...]:
    """Return the table's columns from left to right. Raises InvalidInputError (`export_not_offered`)."""
    check_spec(spec)
    with database.read() as session:
        return columns_of(table_of(session, caller, spec).parts)


def key_of(spec: ExportSpec) -> tuple[str, ...]:
    """Return the columns that identify a row of the table."""
    return (*KEYS[spec.rows], "component") if spec.layout == "long" else KEYS[spec.rows]
