"""The table of days: a row a participant-day, or a row a component of it; the sums are those of GET /v1/days."""

import uuid
from collections.abc import Iterator, Sequence
from datetime import date
from itertools import chain, islice

from sqlalchemy.orm import Session

from app.diary.day_summaries import all_day_summaries
from app.diary.queries import DayRow
from app.diary.study_days import judge_day
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
from app.exports.tables.export_table import Readers, Table, batch_of, named_cells
from app.exports.tables.meal_queries import records_of_days
from app.http.tables import day_columns as of_day
from app.http.tables.columns import Batch, Cell, PartOfBatch, Row
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
        for days in _batches(all_day_summaries(session, caller, spec.filters)):
            sums_of_days = _sums_of(session, days, contents, components) if is_all else list(map(_headline_sums, days))
            if spec.layout == "wide":
                batch = batch_of(of_day.DAY_PARTS, READERS, days)
                yield batch + [
                    PartOfBatch(part, [tuple(chain(*pairs)) for pairs in sums_of_days]) for part in sums_of_all
                ]
            elif components:
                yield long_batch(batch_of(of_day.OF_LONG, READERS, days), components, sums_of_days, LONG_SUM)

    long = (*of_day.OF_LONG, OF_COMPONENT, LONG_SUM, KNOWN)
    return Table((*of_day.DAY_PARTS, *sums_of_all) if spec.layout == "wide" else long, batches())


def day_values(day: DayRow) -> dict[str, Cell]:
    """A day's columns by name, as JSON and files have them."""
    return named_cells(of_day.DAY_PARTS, READERS, day)


def _headline_sums(day: DayRow) -> Sums:
    """Of the ten that records have themselves, as the database has summed them."""
    return [day.amount(name) for name in HEADLINE_COLUMNS]


def _plausible(day: DayRow) -> Row:
    judged = judge_day(day)
    return judged.ratio, judged.verdict


def _counts(day: DayRow) -> Row:
    return (
        day.meals,
        day.meals_after_closing,
        day.median_upload_delay_seconds,
        day.items,
        day.unmeasured_meals,
        day.unmeasured_items,
        day.provisional_items,
        day.leftovers_unknown_items,
        0.0 if day.is_nothing else day.consumed_g,
    )


READERS: Readers[DayRow] = {
    of_day.WHOSE: lambda day: (day.study_code, day.participant_code),
    of_day.WHICH: lambda day: str(day.local_date),
    of_day.STANDING: lambda day: (day.study_day, day.status, day.ate_nothing, day.decided_by),
    of_day.COUNTS: _counts,
    of_day.SUMS: lambda day: tuple(chain(*_headline_sums(day))),
    of_day.PLAUSIBLE: _plausible,
}


def _sums_of(
    session: Session, days: Sequence[DayRow], contents: FoodContents, components: Sequence[ComponentColumn]
) -> list[Sums]:
    """Of each day, of these components, over its records that hold."""
    eaten: dict[tuple[uuid.UUID, date], list[Eaten]] = {}
    people = sorted({day.participant_id for day in days})
    dates = [day.local_date for day in days]
    records = records_of_days(session, people, min(dates), max(dates))
    amounts = contents.amounts([one.food_id for one in records], [one.consumed_g for one in records])
    for record, food_amounts in zip(records, amounts, strict=True):
        eaten.setdefault((record.participant_id, record.local_date), []).append(Eaten(record.consumed_g, food_amounts))
    return [
        sums(
            eaten.get((day.participant_id, day.local_date), ()),
            len(components),
            is_nothing=day.is_nothing,
            is_partial=day.unmeasured_meals > 0,
        )
        for day in days
    ]


def _batches(days: Iterator[DayRow]) -> Iterator[list[DayRow]]:
    while batch := list(islice(days, DAYS_A_BATCH)):
        yield batch
