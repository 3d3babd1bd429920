"""The table of days: a row a participant-day, or a row a component of it; the sums are those of GET /v1/days."""

import uuid
from collections.abc import Iterator, Sequence
from datetime import date
from itertools import islice
from typing import Any, Literal

from sqlalchemy.orm import Session

from app.diary.day_summaries import all_day_summaries
from app.diary.queries import DayFilter, DayRow
from app.diary.study_days import StudyDay, judge_day
from app.exports.export_spec import ExportSpec
from app.exports.tables.export_components import (
    HEADLINE_COMPONENTS,
    Eaten,
    FoodContents,
    Sums,
    components_for,
    long_batch,
    sums,
)
from app.exports.tables.export_table import Table
from app.exports.tables.meal_queries import records_of_days
from app.http.tables import day_columns as of_day
from app.http.tables.columns import Batch, Part, PartOfBatch
from app.http.tables.component_columns import KNOWN, LONG_SUM, OF_COMPONENT, ComponentColumn, wide_sums
from app.meals.record_models import HEADLINE_COLUMNS
from app.people.access.caller import Caller

DAYS_A_BATCH = 500


def day_table(session: Session, caller: Caller, spec: ExportSpec) -> Table:
    """As the filters of GET /v1/days choose, by (day, participant)."""
    is_all = spec.components == "all"
    components = components_for(session, caller, spec) if is_all else HEADLINE_COMPONENTS
    contents = FoodContents(session, components)
    sums_of_all = (wide_sums(components),) if is_all and components else ()

    def batches() -> Iterator[Batch]:
        for days in _batches(all_day_summaries(session, caller, _filter(spec))):
            values = _values(days)
            found = _sums_of(session, days, contents, components) if is_all else headline_sums(days)
            if spec.layout == "wide":
                values |= {part: [[value for pair in its for value in pair] for its in found] for part in sums_of_all}
                yield [PartOfBatch(part, values[part]) for part in (*of_day.DAY_PARTS, *sums_of_all)]
            elif components:
                own = [PartOfBatch(part, values[part]) for part in of_day.OF_LONG]
                yield long_batch(own, components, found, LONG_SUM)

    long = (*of_day.OF_LONG, OF_COMPONENT, LONG_SUM, KNOWN)
    return Table((*of_day.DAY_PARTS, *sums_of_all) if spec.layout == "wide" else long, batches())


def day_values(day: StudyDay) -> dict[str, Any]:
    """A day's columns by name, as JSON and files have them."""
    values = _values([day])
    names = [column.name for part in of_day.DAY_PARTS for column in part.columns]
    row = [value for part in of_day.DAY_PARTS for value in next(iter(PartOfBatch(part, values[part]).as_tuples()))]
    return dict(zip(names, row, strict=True))


def headline_sums(days: Sequence[StudyDay]) -> list[Sums]:
    """Of each day, of the ten that records have themselves: as the database has summed them."""
    return [[(its.value, its.coverage) for its in map(day.row.amount, HEADLINE_COLUMNS)] for day in days]


def _values(days: Sequence[StudyDay]) -> dict[Part, Sequence[Any]]:
    """The rows of each part."""
    judged = [judge_day(day.row) for day in days]
    return {
        of_day.WHOSE: [(day.row.study_code, day.row.participant_code) for day in days],
        of_day.WHICH: [str(day.row.local_date) for day in days],
        of_day.STANDING: [(day.number, day.row.status, day.row.ate_nothing, decided_by(day.row)) for day in days],
        of_day.COUNTS: [_counts(day.row) for day in days],
        of_day.SUMS: [[value for pair in its for value in pair] for its in headline_sums(days)],
        of_day.PLAUSIBLE: [(each.ratio, each.verdict) for each in judged],
    }


def decided_by(row: DayRow) -> Literal["participant", "reviewer"] | None:
    """Whose word about the day holds; None: nobody has said anything."""
    if row.version == 0:
        return None
    return "reviewer" if row.is_by_reviewer else "participant"


def _counts(row: DayRow) -> tuple[float | int | None, ...]:
    return (
        row.meals,
        row.meals_after_closing,
        row.median_upload_delay_seconds,
        row.items,
        row.unmeasured_meals,
        row.unmeasured_items,
        row.provisional_items,
        row.leftovers_unknown_items,
        0.0 if row.is_nothing else row.consumed_g,
    )


def _sums_of(
    session: Session, days: Sequence[StudyDay], contents: FoodContents, components: Sequence[ComponentColumn]
) -> list[Sums]:
    """Of each day, of these components, over its records that hold."""
    eaten: dict[tuple[uuid.UUID, date], list[Eaten]] = {}
    people = sorted({day.row.participant_id for day in days})
    dates = [day.row.local_date for day in days]
    records = records_of_days(session, people, min(dates), max(dates))
    amounts = contents.amounts([one.food_id for one in records], [one.consumed_g for one in records])
    for record, its in zip(records, amounts, strict=True):
        eaten.setdefault((record.participant_id, record.local_date), []).append(Eaten(record.consumed_g, its))
    return [
        sums(
            eaten.get((day.row.participant_id, day.row.local_date), ()),
            len(components),
            is_nothing=day.row.is_nothing,
            is_partial=day.row.unmeasured_meals > 0,
        )
        for day in days
    ]


def _batches(days: Iterator[StudyDay]) -> Iterator[list[StudyDay]]:
    while batch := list(islice(days, DAYS_A_BATCH)):
        yield batch


def _filter(spec: ExportSpec) -> DayFilter:
    filters = spec.filters
    return DayFilter(
        study_code=filters.study_code,
        participant_code=filters.participant_code,
        first_day=filters.first_day,
        last_day=filters.last_day,
    )
