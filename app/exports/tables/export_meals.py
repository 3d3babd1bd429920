"""The tables of meals and of photographs: rows of the meals that the filters of GET /v1/meals choose."""

import uuid
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from urllib.parse import quote

from sqlalchemy.orm import Session

from app.exports.export_spec import ExportSpec
from app.exports.lists.meal_page_queries import pages_of_keys
from app.exports.tables import meal_queries as meal_export
from app.exports.tables.export_components import (
    HEADLINE_COMPONENTS,
    Amounts,
    Eaten,
    FoodContents,
    Sums,
    components_for,
    long_batch,
    sums,
)
from app.exports.tables.export_table import Readers, Table, batch_of
from app.exports.tables.meal_queries import ExportedMeal, HeldAmounts, MealRun
from app.exports.tables.record_queries import point_of
from app.http.tables import meal_columns as of_meal
from app.http.tables.columns import Batch, PartOfBatch, Row, instant_text, local_text
from app.http.tables.component_columns import KNOWN, LONG_SUM, OF_COMPONENT, wide_sums
from app.http.tables.geojson_rows import POINT
from app.http.tables.photograph_columns import PHOTOGRAPH_PARTS
from app.meals.meal_time import number_of
from app.meals.models import MealImage
from app.meals.queries import first_days
from app.meals.record_models import HEADLINE_COLUMNS
from app.people.access.caller import Caller, visible_rows
from app.photos.slots import PAIR_SLOTS

MEALS_A_BATCH = 1000
Photograph = tuple[ExportedMeal, MealImage]
NO_RUN = (None,) * len(of_meal.MEAL_RUN.columns)


def meal_table(session: Session, caller: Caller, spec: ExportSpec) -> Table:
    """A row a meal, or a row a component of it, in the order of capture."""
    is_all = spec.components == "all"
    components = components_for(session, caller, spec) if is_all else []
    contents = FoodContents(session, components)
    sums_of_all = (wide_sums(components),) if components else ()
    provenance = of_meal.MEAL_PROVENANCE if spec.provenance else ()
    place = () if spec.output == "geojson" else (POINT,)
    wide = (*of_meal.BEFORE_SUMS, of_meal.SUMS, *provenance, *place, *sums_of_all)
    long = (*of_meal.OF_LONG, OF_COMPONENT, LONG_SUM, KNOWN)
    in_long = components if is_all else HEADLINE_COMPONENTS

    def batches() -> Iterator[Batch]:
        for ids in _pages(session, caller, spec):
            meals = _meals(session, ids)
            if spec.layout == "wide":
                batch = batch_of([part for part in wide if part not in sums_of_all], READERS, meals)
                for part in sums_of_all:
                    batch.append(PartOfBatch(part, list(map(_flat, _sums_of(meals, contents, len(components))))))
                yield batch + batch_of((POINT,) if spec.output == "geojson" else (), READERS, meals)
            elif in_long:
                sums_of_meals = (
                    _sums_of(meals, contents, len(components)) if is_all else list(map(_headline_sums, meals))
                )
                yield long_batch(batch_of(of_meal.OF_LONG, READERS, meals), in_long, sums_of_meals, LONG_SUM)

    return Table(wide if spec.layout == "wide" else long, batches())


def photograph_table(session: Session, caller: Caller, spec: ExportSpec) -> Table:
    """The image manifest: a row a photograph, in the order of capture."""

    def batches() -> Iterator[Batch]:
        for ids in _pages(session, caller, spec):
            photographs = photographs_of(session, ids)
            if photographs:
                yield batch_of(PHOTOGRAPH_PARTS, PHOTOGRAPH_READERS, photographs)

    return Table(PHOTOGRAPH_PARTS, batches())


def photographs_of(session: Session, ids: Sequence[uuid.UUID]) -> list[Photograph]:
    """The photographs of these meals in the order of capture, each with its meal."""
    images = meal_export.images_of_meals(session, ids)
    return [(meal, image) for meal in meal_export.meals_by_id(session, ids) for image in images.get(meal.id, ())]


@dataclass(frozen=True, slots=True)
class _Meal:
    """A meal with its records that hold, its newest run and its photographs by slot."""

    row: ExportedMeal
    records: Sequence[HeldAmounts]
    run: MealRun | None
    images: Mapping[str, MealImage]
    study_day: int | None

    def sums(self, amounts: Sequence[Amounts], count: int) -> Sums:
        """Of `count` components, of which each record has these amounts."""
        eaten = [Eaten(record.consumed_g, its) for record, its in zip(self.records, amounts, strict=True)]
        is_nothing = not self.records and self.row.status == "confirmed"
        return sums(eaten, count, is_nothing=is_nothing, is_partial=False)


def _meals(session: Session, ids: Sequence[uuid.UUID]) -> list[_Meal]:
    rows = meal_export.meals_by_id(session, ids)
    runs, images = meal_export.last_runs(session, ids), meal_export.images_of_meals(session, ids)
    first_day_of = first_days(session, {row.participant_id for row in rows})
    records = meal_export.records_of_meals(session, ids)
    return [
        _Meal(
            row,
            records.get(row.id, ()),
            runs.get(row.id),
            {image.slot: image for image in images.get(row.id, ())},
            number_of(row.local_date, first_day_of.get(row.participant_id)),
        )
        for row in rows
    ]


def _sums_of(meals: Sequence[_Meal], contents: FoodContents, count: int) -> list[Sums]:
    """Of each meal, of these components."""
    records = [record for meal in meals for record in meal.records]
    amounts = iter(contents.amounts([one.food_id for one in records], [one.consumed_g for one in records]))
    return [meal.sums([next(amounts) for _ in meal.records], count) for meal in meals]


def _headline_sums(meal: _Meal) -> Sums:
    return meal.sums([record.amounts for record in meal.records], len(HEADLINE_COLUMNS))


def _flat(pairs: Sums) -> Row:
    """Sum and coverage of each component, one after the other."""
    return tuple(chain.from_iterable(pairs))


def _when(meal: ExportedMeal) -> Row:
    return instant_text(meal.captured_at), _local(meal), meal.time_zone, str(meal.local_date)


def _local(meal: ExportedMeal) -> str:
    return local_text(meal.captured_at, meal.utc_offset_minutes)


def _standing(meal: _Meal) -> Row:
    is_provisional = any(record.provisional for record in meal.records)
    return meal.row.status, meal.row.origin, meal.row.failure_code, meal.row.after_status, is_provisional


def _foods(meal: _Meal) -> Row:
    keys = dict.fromkeys(record.food_key for record in meal.records if record.food_key is not None)
    return tuple(keys), tuple(dict.fromkeys(flag for record in meal.records for flag in record.flags))


def _counts(meal: _Meal) -> Row:
    records = meal.records
    [(consumed_g, _)] = meal.sums([(record.consumed_g,) for record in records], 1)
    return (
        len(records),
        sum(record.consumed_g is None for record in records),
        sum(record.needs_look for record in records),
        max((record.doubt for record in records), default=None),
        meal.row.version,
        consumed_g,
    )


def _run(meal: _Meal) -> Row:
    if meal.run is None:
        return NO_RUN
    run = meal.run
    return str(run.id), run.method, run.pipeline_version, run.marker, "; ".join(run.food_releases)


def _hashes(meal: _Meal) -> Row:
    pair = [meal.images.get(slot) for slot in PAIR_SLOTS]
    return tuple(chain(*((image.received_sha256, image.stored_sha256) if image else (None, None) for image in pair)))


def _file(photograph: Photograph) -> Row:
    meal, image = photograph
    path = f"/v1/meals/{meal.client_id}/images/{image.slot}?participant={quote(meal.participant_code, safe='')}"
    return (
        image.received_sha256,
        image.stored_sha256,
        instant_text(image.received_at),
        image.erased_at is not None,
        instant_text(image.erased_at) if image.erased_at is not None else None,
        path if image.erased_at is None else None,
    )


READERS: Readers[_Meal] = {
    of_meal.MEAL_KEY: lambda meal: str(meal.row.client_id),
    of_meal.WHOSE: lambda meal: (meal.row.study_code, meal.row.participant_code),
    of_meal.WHEN: lambda meal: _when(meal.row),
    of_meal.ARRIVAL: lambda meal: (
        instant_text(meal.row.received_at),
        (meal.row.received_at - meal.row.captured_at).total_seconds(),
    ),
    of_meal.DAY: lambda meal: (meal.row.day_status, meal.study_day),
    of_meal.STANDING: _standing,
    of_meal.FOODS: _foods,
    of_meal.COUNTS: _counts,
    of_meal.SUMS: lambda meal: _flat(_headline_sums(meal)),
    of_meal.MEAL_RUN: _run,
    of_meal.PHOTOGRAPHS: _hashes,
    POINT: lambda meal: point_of(meal.row.longitude, meal.row.latitude),
}
PHOTOGRAPH_READERS: Readers[Photograph] = dict(
    zip(
        PHOTOGRAPH_PARTS,
        (
            lambda one: str(one[0].client_id),
            lambda one: (
                *(one[0].study_code, one[0].participant_code),
                *(instant_text(one[0].captured_at), _local(one[0]), str(one[0].local_date)),
            ),
            lambda one: (one[1].slot, one[1].media_type),
            lambda one: (one[1].width_px, one[1].height_px, one[1].bytes),
            _file,
        ),
        strict=True,
    )
)


def _pages(session: Session, caller: Caller, spec: ExportSpec) -> Iterator[list[uuid.UUID]]:
    for keys in pages_of_keys(session, visible_rows(caller, spec.filters), size=MEALS_A_BATCH):
        yield [meal_id for _, meal_id in keys]
