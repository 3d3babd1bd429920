"""A table as a file: CSV that is safe to open in a spreadsheet, NDJSON, Parquet or GeoJSON."""

import shutil
from pathlib import Path

import duckdb

from app.exports.live_tables import quoted
from app.exports.table_selects import TableSelect
from app.http.columns.dictionary import Column
from app.http.file_formats import FORMATS, OF_PLACES, Output
from app.http.flat_list import FORMULA_STARTS

GEOJSON_HEAD, GEOJSON_TAIL = b'{"type":"FeatureCollection","features":', b"}\n"
INSTANT, LOCAL_TIME = "%Y-%m-%dT%H:%M:%S.%fZ", "%Y-%m-%dT%H:%M:%S.%f"


def write_table(
    connection: duckdb.DuckDBPyConnection, table: TableSelect, output: Output, path: Path
) -> int:
    """Write the rows in their order; return their number. The same rows give the same bytes."""
    if output in OF_PLACES:
        return _write_geojson(connection, table, output, path)
    return _copy(connection, table, _cells(table.columns, output), output, path)


def _copy(
    connection: duckdb.DuckDBPyConnection,
    table: TableSelect,
    cells: str,
    output: Output,
    path: Path,
) -> int:
    select = f"SELECT {cells} FROM ({table.sql}) ORDER BY {table.order}"
    copy = f"COPY ({select}) TO {quoted(str(path))} ({FORMATS[output].copy_options})"
    (count,) = connection.execute(copy).fetchall()[0]
    return int(count)


def _write_geojson(
    connection: duckdb.DuckDBPyConnection, table: TableSelect, output: Output, path: Path
) -> int:
    """One FeatureCollection (RFC 7946): a feature a row, without a place where none is known."""
    key = table.columns[0].name
    point = "{type: 'Point', coordinates: [longitude, latitude]}"
    members = ", ".join(f'"{column.name}": {_json_value(column)}' for column in table.columns)
    cells = (
        f"'Feature' AS type, \"{key}\" AS id,"
        f" CASE WHEN longitude IS NOT NULL THEN {point} END AS geometry,"
        f" {{{members}}} AS properties"
    )
    features = path.with_suffix(".features")
    try:
        count = _copy(connection, table, cells, output, features)
        with path.open("wb") as file, features.open("rb") as listed:
            file.write(GEOJSON_HEAD)
            shutil.copyfileobj(listed, file)
            file.write(GEOJSON_TAIL)
    finally:
        features.unlink(missing_ok=True)
    return count


def _cells(columns: tuple[Column, ...], output: Output) -> str:
    cell = {"text": _text, "json": _json_value, "typed": _typed}[FORMATS[output].cells]
    return ", ".join(f'{cell(column)} AS "{column.name}"' for column in columns)


def _text(column: Column) -> str:
    name = f'"{column.name}"'
    match column.type:
        case "word":
            return name if column.values else _safe(name)  # of a short list, none is a formula
        case "words":
            return _safe(f"nullif(array_to_string({name}, ' '), '')")
        case "boolean":
            return f"CASE {name} WHEN true THEN 'True' WHEN false THEN 'False' END"
        case _:
            return _json_value(column)


def _safe(text: str) -> str:
    """Text that a spreadsheet would take for a formula, with an apostrophe before it."""
    starts = ", ".join(str(ord(start)) for start in FORMULA_STARTS)
    guarded = f"chr(39) || {text}"
    return f"CASE WHEN unicode({text}) IN ({starts}) THEN {guarded} ELSE {text} END"


def _json_value(column: Column) -> str:
    """Instants and local times as the API's JSON has them, with microseconds where there are any."""
    name = f'"{column.name}"'
    match column.type:
        case "instant":
            return f"replace(strftime({name}, '{INSTANT}'), '.000000Z', 'Z')"
        case "local time":
            return f"regexp_replace(strftime({name}, '{LOCAL_TIME}'), '[.]000000$', '')"
        case "number":
            return _number(name)
        case _:
            return name


def _number(name: str) -> str:
    """A number; 0.0 is never negative: Parquet would keep the sign of the first one of a page."""
    return f"{name}::DOUBLE + 0.0"


def _typed(column: Column) -> str:
    name = f'"{column.name}"'
    match column.type:
        case "number":
            return _number(name)
        case "integer":
            return f"{name}::BIGINT"
        case _:
            return name
