"""The contents of a release, read in one snapshot: the tables of exports, and the foods and densities behind them.

Columns are left out if they would change the files of unchanged data (change counters), or if they do not follow from
frozen figures (releases/release_days.py). With a filter of statuses there is no table of days, since a day covers
everything that was eaten.
"""

import uuid
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from itertools import islice
from typing import Annotated

from pydantic import Field, JsonValue, TypeAdapter
from sqlalchemy.orm import Session

from app.exports.export_spec import ExportSpec, Rows
from app.exports.tables.export_tables import table_of
from app.http.row_filter import RowFilter
from app.http.tables.columns import Column, Row, columns_of
from app.http.tables.participant_columns import MEALS
from app.people.access.caller import StaffCaller
from app.releases import queries as releases
from app.releases.queries import UsedFood
from app.releases.release_days import EATEN, NOT_DERIVABLE, NamedRow, exact_sums, median_delay
from app.releases.release_files import Contents, ReleaseFiles

DAYS_AT_A_TIME = 500
TABLES: tuple[Rows, ...] = ("items", "meals", "days", "photographs", "participants")
LEFT_OUT: Mapping[Rows, Collection[str]] = {
    "items": ("change_seq",),
    "meals": ("version",),
    "days": NOT_DERIVABLE,
    "photographs": (),
    "participants": [column.name for column in MEALS],  # an erasure of a meal would change them
}
FOOD = (
    Column("food_key", "word", meaning="The food's key: the same through releases and versions."),
    Column("food_version", "integer", meaning="The food's version in its table's release.", empty="Of any version."),
    Column("food_table", "word", meaning="The food table's name and release.", empty="Of any table."),
)
FOODS = (
    *FOOD,
    Column("name", "word", meaning="The food's name."),
    Column("food_group", "word", meaning="Its group in the table."),
    Column("state", "word", meaning="Raw, cooked ...", empty="The table does not say."),
    Column("is_mixed_dish", "boolean", meaning="Whether it is a dish of several foods."),
)
FOOD_NUTRIENTS = (
    *FOOD,
    Column("number", "word", meaning="The component's number in its source."),
    Column("tagname", "word", meaning="INFOODS tagname.", empty="There is none."),
    Column("component", "word", meaning="The component's name."),
    Column("unit", "word", meaning="Unit of per_100_g."),
    Column("per_100_g", "number", meaning="How much of it 100 g of the edible portion hold, in `unit`."),
)
FOOD_DENSITIES = (
    *FOOD,
    Column("measured_by", "word", meaning="Whose figure it is.", values=("table", "study")),
    Column("g_per_ml", "number", "g/ml", "The density."),
    Column("sd_g_per_ml", "number", "g/ml", "Its spread (one sd)."),
    Column("state", "word", meaning="Of the food as it was measured."),
    Column("kind", "word", meaning="Of the food's own matter, or of a heap of pieces.", values=("solid", "bulk")),
    Column("basis", "word", meaning="What kind of figure it is.", empty="Measured by the study."),
    Column("weighs", "word", meaning="Of what the grams are.", values=("as_seen", "edible")),
    Column("source", "word", meaning="Who measured it."),
)
OF_FOODS = {"foods": FOODS, "food_nutrients": FOOD_NUTRIENTS, "food_densities": FOOD_DENSITIES}


@dataclass(frozen=True, slots=True)
class ReleaseFilters:
    """Local days, both included, and statuses of items; None or an empty tuple is no filter."""

    first_day: Annotated[date | None, Field(alias="from")] = None
    last_day: Annotated[date | None, Field(alias="to")] = None
    statuses: tuple[str, ...] = ()

    def as_json(self) -> dict[str, JsonValue]:
        """Return the filters as JSON values."""
        values: dict[str, JsonValue] = FILTERS.dump_python(self, mode="json", by_alias=True)
        return values


FILTERS = TypeAdapter(ReleaseFilters)


def filters_of_json(values: Mapping[str, JsonValue]) -> ReleaseFilters:
    """Return the filters that `as_json` stored."""
    return FILTERS.validate_python(values)


def freeze(
    session: Session, study_id: uuid.UUID, study_code: str, filters: ReleaseFilters, files: ReleaseFiles
) -> Contents:
    """Write all tables and the dictionary from the session's snapshot."""
    contents = Contents()
    for name in TABLES:
        if name == "days" and filters.statuses:
            continue
        columns, rows = _table(session, study_id, study_code, filters, name)
        files.add_table(name, columns, contents.count_rows(name, columns, rows))
    add_foods(session, study_id, contents.foods, files)
    files.add_dictionary()
    return contents


def add_foods(session: Session, study_id: uuid.UUID, used: Collection[UsedFood], files: ReleaseFiles) -> None:
    """Write the foods of the items, their nutrients, and the densities that may have weighed them."""
    ids = releases.foods_used(session, used)
    foods = releases.foods_by_id(session, list(ids))
    files.add_table(
        "foods",
        FOODS,
        (
            (*key, foods[id_].name, foods[id_].food_group, foods[id_].state, foods[id_].is_mixed_dish)
            for id_, key in ids.items()
        ),
    )
    files.add_table(
        "food_nutrients",
        FOOD_NUTRIENTS,
        (
            (*ids[food_id], *values)
            for food_id, nutrients in releases.nutrients_by_food(session, list(ids))
            for values in nutrients
        ),
    )
    files.add_table("food_densities", FOOD_DENSITIES, _densities(session, study_id, ids))


def _table(
    session: Session, study_id: uuid.UUID, study_code: str, filters: ReleaseFilters, name: Rows
) -> tuple[Sequence[Column], Iterator[Row]]:
    from app.http.tables.table_files import rows_of_batches  # noqa: PLC0415  # pyarrow

    spec = ExportSpec(
        name,
        output="parquet",
        components="all" if name == "items" else "headline",
        filters=RowFilter(
            study_code=study_code,
            first_day=filters.first_day,
            last_day=filters.last_day,
            statuses=filters.statuses if name == "items" else (),
        ),
    )
    table = table_of(session, _reader(study_id), spec)
    columns = columns_of(table.parts)
    places = [place for place, column in enumerate(columns) if column.name not in LEFT_OUT[name]]
    rows = (tuple(row[place] for place in places) for row in rows_of_batches(table.batches))
    kept = [columns[place] for place in places]
    return kept, exact_days(session, study_id, kept, rows) if name == "days" else rows


def exact_days(session: Session, study_id: uuid.UUID, columns: Sequence[Column], rows: Iterator[Row]) -> Iterator[Row]:
    """Yield the rows of days with sums that do not depend on the order in which a database adds. rows: by day."""
    names = [column.name for column in columns]
    named: Iterator[NamedRow] = (dict(zip(names, row, strict=True)) for row in rows)
    while days := list(islice(named, DAYS_AT_A_TIME)):
        codes = {day["participant"] for day in days}
        first, last = (date.fromisoformat(days[place]["local_date"]) for place in (0, -1))
        eaten: dict[tuple[str, str], list[NamedRow]] = {}
        for code, local_date, *amounts in releases.eaten_on_days(session, study_id, codes, first, last):
            record = dict(zip(EATEN, amounts, strict=True))
            eaten.setdefault((code, local_date.isoformat()), []).append(record)
        delays: dict[tuple[str, str], list[float]] = {}
        for code, local_date, captured_at, received_at in releases.arrivals_on_days(
            session, study_id, codes, first, last
        ):
            seconds = (received_at - captured_at).total_seconds()
            delays.setdefault((code, local_date.isoformat()), []).append(seconds)
        for day in days:
            key = (day["participant"], day["local_date"])
            exact = exact_sums(
                eaten.get(key, []), is_nothing=_is_nothing(day), is_partial=day["unmeasured_meals"] > 0
            ) | {"median_upload_delay_seconds": median_delay(delays.get(key, []))}
            yield tuple(exact.get(name, day[name]) for name in names)


def _is_nothing(day: NamedRow) -> bool:
    """As DayRow: nothing eaten was stated, or every meal of the closed day was confirmed to be without food."""
    is_empty = day["meals"] > 0 and day["items"] == 0 and day["unmeasured_meals"] == 0
    return bool(day["ate_nothing"] or (day["day_status"] == "closed" and is_empty))


def _densities(session: Session, study_id: uuid.UUID, ids: Mapping[int, UsedFood]) -> Iterator[Row]:
    for food_id, densities in releases.densities_by_food(session, list(ids)).items():
        for density in densities:
            yield (
                *(*ids[food_id], "table", density.g_per_ml, density.sd_g_per_ml),
                *(density.state, density.kind, density.basis, density.weighs, density.source),
            )
    for own in releases.study_densities(session, study_id, {key for key, _, _ in ids.values()}):
        yield (
            *(own.food_key, None, None, "study", own.g_per_ml, own.sd_g_per_ml),
            *(own.state, own.kind, None, own.weighs, own.source),
        )


def _reader(study_id: uuid.UUID) -> StaffCaller:
    """Return a viewer of this study who is no real person."""
    nobody = uuid.UUID(int=0)
    return StaffCaller(
        nobody, "", is_admin=False, token_id=nobody, roles={study_id: "viewer"}, can_write=False, only_study_id=study_id
    )
