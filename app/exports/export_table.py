"""The task of writing one table into a file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import duckdb

from app.exports.export_spec import spec_of_json
from app.exports.table_selects import Scope, select_table
from app.exports.write_table import write_table


def export_table(
    connection: duckdb.DuckDBPyConnection, request: Mapping[str, Any]
) -> dict[str, Any]:
    """Write the table; return its number of rows."""
    spec = spec_of_json(request["spec"])
    table = select_table(connection, spec, Scope(request["studies"], request["participants"]))
    rows = write_table(connection, table, spec.output, Path(request["path"]))
    return {"rows": rows}
