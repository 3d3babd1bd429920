"""The task of freezing a study's data: its tables as Parquet and CSV, in one transaction."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import duckdb

from app.exports.export_spec import ExportSpec
from app.exports.live_tables import limited_duckdb, quoted
from app.exports.releases.release_filters import filters_of_json
from app.exports.releases.tables import LEFT_OUT, OF_FOODS, TABLES
from app.exports.table_selects import Scope, TableSelect, select_table
from app.exports.write_table import write_table
from app.http.columns.dictionary import Column
from app.http.row_filter import RowFilter

FOODS_SQL = (Path(__file__).parent / "foods.sql").read_text("utf-8")
ORDERS = {
    "foods": "food_key, food_table, food_version",
    "food_nutrients": "food_key, food_table, food_version, number",
    "food_densities": "is_of_study, food_key, food_table, food_version, place, measured_at, id",
}
USED_FOODS = (
    "SELECT DISTINCT food_key, food_version, food_table FROM items WHERE food_key IS NOT NULL"
)


def freeze_tables(
    connection: duckdb.DuckDBPyConnection, request: Mapping[str, Any]
) -> dict[str, Any]:
    """Write the tables of a study into a folder; return what write_pair does, by name."""
    folder, study_id = Path(request["folder"]), request["study_id"]
    filters = filters_of_json(request["filters"])
    tables: dict[str, Any] = {}
    for name in TABLES:
        if name == "days" and filters.statuses:
            continue
        spec = ExportSpec(
            name,
            output="parquet",
            components="all" if name == "items" else "headline",
            filters=RowFilter(
                first_day=filters.first_day,
                last_day=filters.last_day,
                statuses=filters.statuses if name == "items" else (),
            ),
        )
        table = select_table(connection, spec, Scope([study_id]))
        columns = tuple(column for column in table.columns if column.name not in LEFT_OUT[name])
        table = TableSelect(columns, table.sql, table.order)
        tables[name] = write_pair(connection, name, table, folder)
    connection.execute(f"SET VARIABLE study_id = {quoted(study_id)}")
    create_view(connection, "items", folder)
    connection.execute(f"CREATE TEMP VIEW used AS {USED_FOODS}")
    connection.execute(FOODS_SQL)
    for of_foods, columns in OF_FOODS.items():
        select = f"SELECT * FROM release_{of_foods}"
        table = TableSelect(columns, select, ORDERS[of_foods])
        tables[of_foods] = write_pair(connection, of_foods, table, folder)
    return tables


def write_pair(
    connection: duckdb.DuckDBPyConnection, name: str, table: TableSelect, folder: Path
) -> dict[str, Any]:
    """Write NAME.parquet, and NAME.csv from it; return its columns and the number of rows."""
    path = folder / f"{name}.parquet"
    rows = write_table(connection, table, "parquet", path)
    frozen = TableSelect(table.columns, *rows_in_order(path))
    write_table(connection, frozen, "csv", folder / f"{name}.csv")
    return {"rows": rows, "columns": [asdict(column) for column in table.columns]}


def rows_in_order(path: Path) -> tuple[str, str]:
    """The SELECT of a Parquet file's rows, and their order."""
    place = "file_row_number"
    return f"SELECT * FROM read_parquet({quoted(str(path))}, file_row_number = true)", place


def create_view(connection: duckdb.DuckDBPyConnection, name: str, folder: Path) -> None:
    """Show a file of the folder as a table."""
    path = quoted(str(folder / f"{name}.parquet"))
    connection.execute(f"CREATE OR REPLACE TEMP VIEW {name} AS SELECT * FROM {path}")


def contents_of(folder: Path) -> dict[str, Any]:
    """What the items and meals of a folder are made of, for the manifest."""
    with limited_duckdb(folder) as connection:
        create_view(connection, "items", folder)
        create_view(connection, "meals", folder)

        def counted(column: str) -> dict[str, int]:
            rows = connection.execute(
                f"SELECT {column}, count(*) FROM items WHERE {column} IS NOT NULL GROUP BY 1 ORDER BY 1"
            ).fetchall()
            return dict(rows)

        def count(sql: str) -> int:
            ((number,),) = connection.execute(sql).fetchall()
            return int(number)

        return {
            "pipeline_versions": counted("pipeline_version"),
            "methods": counted("method"),
            "food_tables": counted("food_table"),
            "foods": count(f"SELECT count(*) FROM ({USED_FOODS})"),
            "placed_meals": count("SELECT count(latitude) FROM meals"),
        }


def columns_of_json(values: Sequence[Mapping[str, Any]]) -> tuple[Column, ...]:
    """Columns as write_pair returned them."""
    return tuple(Column(**{**value, "values": tuple(value["values"])}) for value in values)
