"""The tables of meals and of photographs: rows of the meals that the filters of GET /v1/meals choose."""

import uuid
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, cast
from urllib.parse import quote

from sqlalchemy.orm import Session

from app.diary import diary_queries as diary
from app.diary.study_days import number_of
from app.exports.export_spec import ExportSpec
from app.exports.lists.list_meals import visible_meals
from app.exports.lists.meal_page_queries import MealFilter, pages_of_keys
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
from app.exports.tables.export_table import Table
from app.exports.tables.record_queries import point_of
from app.http.tables import meal_columns as of_meal
from app.http.tables.columns import Batch, Part, PartOfBatch, instant_text
from app.http.tables.component_columns import KNOWN, LONG_SUM, OF_COMPONENT, wide_sums
from app.http.tables.geojson_rows import POINT
from app.http.tables.photograph_columns import PHOTOGRAPH_PARTS
from app.meals.record_models import HEADLINE_COLUMNS
from app.people.access.caller import Caller

MEALS_A_BATCH = 1000
Ids = list[uuid.UUID]
NO_RUN = (None,) * len(of_meal.MEAL_RUN.columns)
ORDINARY = ("left", "right")


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
            meals = _Meals(session, ids)
            if spec.layout == "wide":
                values = meals.values() | {
                    part: _side_by_side(meals.sums_of(contents, len(components))) for part in sums_of_all
                }
                parts = (*wide, POINT) if spec.output == "geojson" else wide
                yield [PartOfBatch(part, values[part]) for part in parts]
            elif in_long:
                found = meals.sums_of(contents, len(components)) if is_all else meals.headline_sums()
                values = meals.values()
                own = [PartOfBatch(part, values[part]) for part in of_meal.OF_LONG]
                yield long_batch(own, in_long, found, LONG_SUM)

    return Table(wide if spec.layout == "wide" else long, batches())


def photograph_table(session: Session, caller: Caller, spec: ExportSpec) -> Table:
    """The image manifest: a row a photograph, in the order of capture."""

    def batches() -> Iterator[Batch]:
        for ids in _pages(session, caller, spec):
            rows = photographs_of(session, ids)
            if rows:
                columns = zip(PHOTOGRAPH_PARTS, zip(*rows, strict=True), strict=True)
                yield [PartOfBatch(part, own) for part, own in columns]

    return Table(PHOTOGRAPH_PARTS, batches())


def photographs_of(session: Session, ids: Sequence[uuid.UUID]) -> list[tuple[Any, ...]]:
    """The photographs of these meals in the order of capture: of each the values of PHOTOGRAPH_PARTS."""
    images = meal_export.images_of_meals(session, ids)
    meals = meal_export.meals_by_id(session, ids)
    return [_photograph(meal, image) for meal in meals for image in images.get(meal.id, ())]


class _Meals:
    """A page of meals with their records."""

    def __init__(self, session: Session, ids: Ids) -> None:
        self._meals = meal_export.meals_by_id(session, ids)
        self._runs = meal_export.last_runs(session, ids)
        self._images = meal_export.images_of_meals(session, ids)
        self._first_days = diary.first_days(session, {meal.participant_id for meal in self._meals})
        self._records: dict[uuid.UUID, list[Any]] = {meal.id: [] for meal in self._meals}
        for record in meal_export.records_of_meals(session, ids):
            self._records[record.meal_id].append(record)

    def values(self) -> dict[Part, Sequence[Any]]:
        """The rows of each part."""
        meals = self._meals
        return {
            of_meal.MEAL_KEY: [str(meal.client_id) for meal in meals],
            of_meal.WHOSE: [(meal.study_code, meal.participant_code) for meal in meals],
            of_meal.WHEN: [(instant_text(meal.captured_at), meal.time_zone, str(meal.local_date)) for meal in meals],
            of_meal.ARRIVAL: [
                (instant_text(meal.received_at), (meal.received_at - meal.captured_at).total_seconds())
                for meal in meals
            ],
            of_meal.DAY: [
                (meal.day_status, number_of(meal.local_date, self._first_days.get(meal.participant_id)))
                for meal in meals
            ],
            of_meal.STANDING: [self._standing(meal) for meal in meals],
            of_meal.FOODS: [_foods(self._records[meal.id]) for meal in meals],
            of_meal.COUNTS: [self._counts(meal) for meal in meals],
            of_meal.SUMS: _side_by_side(self.headline_sums()),
            of_meal.MEAL_RUN: [_run(self._runs.get(meal.id)) for meal in meals],
            of_meal.PHOTOGRAPHS: [_hashes(self._images.get(meal.id, ())) for meal in meals],
            POINT: [point_of(meal.longitude, meal.latitude) for meal in meals],
        }

    def headline_sums(self) -> list[Sums]:
        """Of each meal, of the ten that records have themselves."""
        return [
            self._sums(meal, [[getattr(one, name) for name in HEADLINE_COLUMNS] for one in self._records[meal.id]])
            for meal in self._meals
        ]

    def sums_of(self, contents: FoodContents, count: int) -> list[Sums]:
        """Of each meal, of these components."""
        records = [one for meal in self._meals for one in self._records[meal.id]]
        amounts = iter(contents.amounts([one.food_id for one in records], [one.consumed_g for one in records]))
        return [self._sums(meal, [next(amounts) for _ in self._records[meal.id]], count) for meal in self._meals]

    def _sums(self, meal: Any, amounts: Sequence[Amounts], count: int = len(HEADLINE_COLUMNS)) -> Sums:
        records = self._records[meal.id]
        eaten = [Eaten(one.consumed_g, its) for one, its in zip(records, amounts, strict=True)]
        is_nothing = not records and meal.status == "confirmed"
        return sums(eaten, count, is_nothing=is_nothing, is_partial=False)

    def _standing(self, meal: Any) -> tuple[Any, ...]:
        is_provisional = any(one.provisional for one in self._records[meal.id])
        return meal.status, meal.origin, meal.failure_code, meal.after_status, is_provisional

    def _counts(self, meal: Any) -> tuple[Any, ...]:
        records = self._records[meal.id]
        [(consumed_g, _)] = self._sums(meal, [(one.consumed_g,) for one in records], 1)
        return (
            len(records),
            sum(one.consumed_g is None for one in records),
            sum(not one.reviewed for one in records),
            max((one.doubt for one in records), default=None),
            meal.version,
            consumed_g,
        )


def _pages(session: Session, caller: Caller, spec: ExportSpec) -> Iterator[Ids]:
    filters = spec.filters
    chosen = MealFilter(
        study_code=filters.study_code,
        participant_code=filters.participant_code,
        first_day=filters.first_day,
        last_day=filters.last_day,
        statuses=filters.statuses,
        origin=filters.origin,
        failure_codes=filters.failure_codes,
        after_statuses=filters.after_statuses,
        food_keys=filters.food_keys,
        flags=filters.flags,
        needs=cast(Any, filters.needs),
    )
    for keys in pages_of_keys(session, visible_meals(caller, chosen), size=MEALS_A_BATCH):
        yield [meal_id for _, meal_id in keys]


def _foods(records: Sequence[Any]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    keys = dict.fromkeys(one.food_key for one in records if one.food_key is not None)
    return tuple(keys), tuple(dict.fromkeys(flag for one in records for flag in one.flags))


def _run(run: Any) -> tuple[Any, ...]:
    if run is None:
        return NO_RUN
    return str(run.id), run.method, run.pipeline_version, run.marker, "; ".join(run.food_releases)


def _hashes(images: Sequence[Any]) -> tuple[str | None, ...]:
    found: Mapping[str, Any] = {image.slot: image for image in images}
    return tuple(
        getattr(found[slot], name) if slot in found else None
        for slot in ORDINARY
        for name in ("received_sha256", "stored_sha256")
    )


def _photograph(meal: Any, image: Any) -> tuple[Any, ...]:
    is_erased = image.erased_at is not None
    path = f"/v1/meals/{meal.client_id}/images/{image.slot}?participant={quote(meal.participant_code, safe='')}"
    return (
        str(meal.client_id),
        (meal.study_code, meal.participant_code, instant_text(meal.captured_at), str(meal.local_date)),
        (image.slot, image.media_type),
        (image.width_px, image.height_px, image.bytes),
        (
            image.received_sha256,
            image.stored_sha256,
            instant_text(image.received_at),
            is_erased,
            instant_text(image.erased_at) if is_erased else None,
            None if is_erased else path,
        ),
    )


def _side_by_side(found: Sequence[Sums]) -> list[list[float | None]]:
    """Sum and coverage of each component, one after the other."""
    return [[value for pair in its for value in pair] for its in found]
