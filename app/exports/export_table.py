"""The task of writing one table into a file, and its request as JSON."""

import uuid
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import duckdb
from pydantic import JsonValue

from app.exports.export_spec import ExportSpec, spec_as_json, spec_of_json
from app.exports.table_selects import Scope, select_table
from app.exports.write_table import write_table


def export_request(
    spec: ExportSpec,
    study_ids: Collection[uuid.UUID] | None,
    participant_ids: Collection[uuid.UUID] | None,
    path: Path,
) -> dict[str, JsonValue]:
    """What `export_table` is asked. study_ids, participant_ids: whose rows; None: all."""
    return {
        "spec": spec_as_json(spec),
        "studies": _listed(study_ids),
        "participants": _listed(participant_ids),
        "path": str(path),
    }


def export_table(
    connection: duckdb.DuckDBPyConnection, request: Mapping[str, Any]
) -> dict[str, Any]:
    """Write the table; return its number of rows."""
    spec = spec_of_json(request["spec"])
    table = select_table(connection, spec, Scope(request["studies"], request["participants"]))
    rows = write_table(connection, table, spec.output, Path(request["path"]))
    return {"rows": rows}


def _listed(ids: Collection[uuid.UUID] | None) -> JsonValue:
    return None if ids is None else [str(id_) for id_ in sorted(ids)]
