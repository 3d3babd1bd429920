"""The SELECT behind each exported table, over the views of live_tables.py."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import duckdb

from app.exports.export_spec import ExportSpec, Rows
from app.exports.live_tables import quoted
from app.exports.table_columns import columns_of, components_of
from app.http.columns.component_columns import (
    HEADLINE_COMPONENTS,
    ComponentColumn,
    component_column,
)
from app.http.columns.dictionary import Column
from app.http.row_filter import RowFilter

VIEWS: Mapping[Rows, str] = {
    "items": "records",
    "meals": "meals",
    "days": "days",
    "photographs": "photographs",
    "participants": "participants",
}
ORDERS: Mapping[Rows, str] = {
    "items": "captured_at, place_in_order",
    "meals": "captured_at, place_in_order",
    "days": "local_date, place_in_order",
    "photographs": "captured_at, place_in_order, place_of_slot",
    "participants": "study, participant",
}
# Views whose rows are kept, on disk where memory ends, before a table joins them, as its rows are
# before they are ordered: in one query all that is joined and ordered would stand in memory.
SUMS: Mapping[Rows, tuple[str, ...]] = {
    "meals": ("sums_of_meals", "words_of_meals"),
    "days": ("meals_of_days", "records_of_days"),
    "photographs": ("sums_of_meals", "words_of_meals"),
}
HEADLINE_NAMES = frozenset(component.column.name for component in HEADLINE_COMPONENTS)
KEYS_OF_EATEN: Mapping[Rows, str] = {  # columns that a row shares with its records
    "meals": "meal_key",
    "days": "participant_id, local_date",
}


@dataclass(frozen=True, slots=True)
class Scope:
    """The studies and participants that a filter and its caller leave, by id; None: all."""

    study_ids: Sequence[str] | None = None
    participant_ids: Sequence[str] | None = None

    @property
    def condition(self) -> str:
        """The same in SQL."""
        return " AND ".join(
            [
                "true",
                *_among("study_id", self.study_ids),
                *_among("participant_id", self.participant_ids),
            ]
        )


@dataclass(frozen=True, slots=True)
class TableSelect:
    """A table to be written.

    columns: from left to right, each by its name in `sql`.
    order: what its rows are ordered by.
    """

    columns: tuple[Column, ...]
    sql: str
    order: str


def select_table(
    connection: duckdb.DuckDBPyConnection, spec: ExportSpec, scope: Scope
) -> TableSelect:
    """The table that a spec names, as far as the scope reaches."""
    sums = SUMS.get(spec.rows, ())
    for name in sums:
        connection.execute(f"CREATE TABLE IF NOT EXISTS kept_{name} AS SELECT * FROM {name}")
        connection.execute(f"CREATE OR REPLACE VIEW {name} AS SELECT * FROM kept_{name}")
    view, order = VIEWS[spec.rows], ORDERS[spec.rows]
    sql = f"SELECT * FROM {view} WHERE {scope.condition}{_conditions(spec)}"
    if sums:
        connection.execute(f"CREATE OR REPLACE TABLE kept_rows AS {sql}")
        sql = "SELECT * FROM kept_rows"
    if spec.layout == "wide" and spec.components == "headline":
        return TableSelect(columns_of(spec, ()), sql, order)
    of_foods = _components_in_use(connection, scope) if spec.components == "all" else ()
    components = components_of(spec, of_foods)
    _create_contents(connection, components)
    columns = columns_of(spec, of_foods)
    if spec.layout == "long":
        return TableSelect(columns, _long(spec, scope, sql), f"{order}, component_place")
    if spec.rows == "items":
        return TableSelect(columns, _wide_items(sql, components), order)
    return TableSelect(columns, _wide_sums(spec, scope, sql, components), order)


def show_tables(connection: duckdb.DuckDBPyConnection, study_code: str | None) -> None:
    """Let a query see the exported tables with their columns, of one study or of all."""
    condition = f"study = {quoted(study_code)}" if study_code is not None else "true"
    columns = {"components": "* EXCLUDE (study_id)"}
    for rows, view in VIEWS.items():
        columns[view] = ", ".join(column.name for column in columns_of(ExportSpec(rows), ()))
    connection.execute("CREATE SCHEMA shown")
    for view, listed in columns.items():
        connection.execute(
            f"CREATE VIEW shown.{view} AS SELECT {listed} FROM main.{view} WHERE {condition}"
        )
    ((path,),) = connection.execute("SELECT current_setting('search_path')").fetchall()
    connection.execute(f"SET search_path = 'memory.shown,{path}'")


def _among(column: str, values: Sequence[str] | None) -> list[str]:
    if values is None:
        return []
    return [f"{column} IN ({', '.join(map(quoted, values))})" if values else "false"]


def _conditions(spec: ExportSpec) -> str:
    """The filters besides study and participant, each with a leading AND."""
    if spec.rows == "participants":
        return ""
    filters = spec.filters
    days = _of_days(filters)
    if spec.rows == "photographs":
        of_meals = _of_meals(filters)
        if not of_meals:
            return _joined(days)
        meals = f"SELECT place_in_order FROM meals WHERE true{_joined(of_meals)}"
        return _joined([*days, f"place_in_order IN ({meals})"])
    if spec.rows == "meals":
        return _joined([*days, *_of_meals(filters)])
    of_items = [
        *_among("food_key", filters.food_keys or None),
        *_among("status", filters.statuses or None),
    ]
    return _joined([*days, *of_items])


def _joined(conditions: Sequence[str]) -> str:
    return "".join(f" AND {condition}" for condition in conditions)


def _of_days(filters: RowFilter) -> list[str]:
    bounds = (("local_date >=", filters.first_day), ("local_date <=", filters.last_day))
    return [f"{bound} DATE '{day}'" for bound, day in bounds if day is not None]


def _of_meals(filters: RowFilter) -> list[str]:
    conditions = [
        *_among("status", filters.statuses or None),
        *_among("failure_code", filters.failure_codes or None),
        *_among("after_status", filters.after_statuses or None),
        *_among("origin", [filters.origin] if filters.origin is not None else None),
    ]
    for column, words in (("food_keys", filters.food_keys), ("flags", filters.flags)):
        if words:
            listed = ", ".join(map(quoted, words))
            conditions.append(f"list_has_any({column}, [{listed}])")
    if filters.needs == "review":
        conditions.append("unreviewed_items > 0")
    if filters.needs == "answer":
        conditions.append("place_in_order IN (SELECT meal_id FROM open_questions)")
    return conditions


def _components_in_use(
    connection: duckdb.DuckDBPyConnection, scope: Scope
) -> list[ComponentColumn]:
    """Those of the foods that records of the scope's studies have, whatever the other filters."""
    of_studies = Scope(scope.study_ids).condition
    rows = connection.execute(
        "SELECT number, name, unit, tagname, expression FROM component WHERE id IN ("
        " SELECT component_id FROM food_nutrient WHERE food_id IN ("
        f"  SELECT food_id FROM foods_of_records WHERE {of_studies})) ORDER BY id"
    ).fetchall()
    return [component_column(*row) for row in rows]


def _create_contents(
    connection: duckdb.DuckDBPyConnection, components: Sequence[ComponentColumn]
) -> None:
    """Two tables: the components, numbered from 1, and what each food has of them, as a list."""
    connection.execute(
        "CREATE OR REPLACE TEMP TABLE chosen (component_place INTEGER, component VARCHAR,"
        " numbers VARCHAR[], tagname VARCHAR, component_name VARCHAR, unit VARCHAR)"
    )
    for place, component in enumerate(components, start=1):
        column = component.column
        connection.execute(
            "INSERT INTO chosen VALUES (?, ?, ?, ?, ?, ?)",
            [
                place,
                column.name,
                list(component.numbers),
                component.tagname,
                component.title,
                column.unit,
            ],
        )
    connection.execute(
        "CREATE OR REPLACE TEMP TABLE food_contents AS"
        " SELECT food_id, list(per_100_g ORDER BY component_place) AS contents FROM ("
        "  SELECT used.food_id, component_place,"
        "   arg_min(per_100_g, list_position(numbers, component.number)) AS per_100_g"
        "  FROM (SELECT DISTINCT food_id FROM effective_record WHERE food_id IS NOT NULL) used"
        "  CROSS JOIN chosen"
        "  LEFT JOIN component ON list_contains(numbers, component.number)"
        "  LEFT JOIN food_nutrient ON food_nutrient.food_id = used.food_id"
        "   AND food_nutrient.component_id = component.id"
        "  GROUP BY used.food_id, component_place"
        " ) GROUP BY food_id"
    )


def _wide_items(sql: str, components: Sequence[ComponentColumn]) -> str:
    amounts = "".join(
        f', consumed_g * (contents[{place}] / 100.0) AS "{component.column.name}"'
        for place, component in enumerate(components, start=1)
        if component.column.name.lower() not in HEADLINE_NAMES
    )
    return f"SELECT items.*{amounts} FROM ({sql}) items LEFT JOIN food_contents USING (food_id)"


def _eaten(scope: Scope) -> str:
    """The records that hold, each with what its food has of the components."""
    return (
        f"(SELECT * FROM records LEFT JOIN food_contents USING (food_id)"
        f" WHERE status <> 'rejected' AND {scope.condition})"
    )


def _wide_sums(
    spec: ExportSpec, scope: Scope, sql: str, components: Sequence[ComponentColumn]
) -> str:
    keys = KEYS_OF_EATEN[spec.rows]
    sums, columns = "", ""
    for place, component in enumerate(components, start=1):
        if component.column.name.lower() in HEADLINE_NAMES:
            continue
        name, amount = component.column.name, f"consumed_g * (contents[{place}] / 100.0)"
        sums += f", sum_of({amount}) AS amount_{place}"
        sums += f", coverage_of({amount}, consumed_g) AS coverage_{place}"
        columns += f', {_amount(f"amount_{place}")} AS "{name}"'
        columns += f', {_coverage(f"coverage_{place}")} AS "{name}_coverage"'
    of_rows = f"SELECT {keys}{sums} FROM {_eaten(scope)} GROUP BY {keys}"
    return f"SELECT rows.*{columns} FROM ({sql}) rows LEFT JOIN ({of_rows}) USING ({keys})"


def _long(spec: ExportSpec, scope: Scope, sql: str) -> str:
    """A row a component."""
    table = (
        f"({sql}) rows CROSS JOIN"
        " (SELECT component_place, component, numbers[1] AS number, tagname, component_name, unit"
        "  FROM chosen)"
    )
    if spec.rows == "items":
        amount = "consumed_g * (contents[component_place] / 100.0)"
        if spec.components == "headline":
            amount = _by_place("{}")
        return (
            f"SELECT *, contents[component_place] AS per_100_g, {amount} AS amount,"
            f" amount IS NOT NULL AS known FROM {table} LEFT JOIN food_contents USING (food_id)"
        )
    if spec.components == "headline":
        return (
            f"SELECT *, {_by_place('{}')} AS amount, {_by_place('{}_coverage')} AS coverage,"
            f" amount IS NOT NULL AS known FROM {table}"
        )
    keys = KEYS_OF_EATEN[spec.rows]
    amount = "consumed_g * (contents[component_place] / 100.0)"
    sums = (
        f"SELECT {keys}, component_place, sum_of({amount}) AS sum_amount,"
        f" coverage_of({amount}, consumed_g) AS sum_coverage"
        f" FROM {_eaten(scope)} CROSS JOIN chosen GROUP BY {keys}, component_place"
    )
    return (
        f"SELECT *, {_amount('sum_amount')} AS amount, {_coverage('sum_coverage')} AS coverage,"
        f" amount IS NOT NULL AS known"
        f" FROM {table} LEFT JOIN ({sums}) USING ({keys}, component_place)"
    )


def _by_place(name: str) -> str:
    """The headline component of this place, of those that the row has itself."""
    whens = "".join(
        f" WHEN {place} THEN {name.format(component.column.name)}"
        for place, component in enumerate(HEADLINE_COMPONENTS, start=1)
    )
    return f"CASE component_place{whens} END"


def _amount(summed: str) -> str:
    return f"CASE WHEN is_nothing THEN 0.0 ELSE {summed} END"


def _coverage(summed: str) -> str:
    return f"CASE WHEN is_nothing THEN 1.0 WHEN NOT is_partial THEN {summed} END"
