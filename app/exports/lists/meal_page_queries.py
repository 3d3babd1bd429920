"""SQL of the keys (captured_at, id) of a page of meals, read from indexes for all filters, in either order.

Each filter has an index with its meals in the page's order: of meals (study, status and origin, failure, after-meal
pair, participant) or of records (food, flags, not reviewed). The page is read from the index with the fewest meals, and
the other filters are checked meal by meal. So a rare filter beside a common one is fast, and a filter without matches
costs nothing.
"""

import itertools
import uuid
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.statements import AnyColumn, Condition, Conditions
from app.http.row_filter import RowFilter
from app.meals.stored.models import MEAL_ORIGINS, MEAL_STATUSES, Meal
from app.meals.stored.record_models import EffectiveRecord
from app.records import page_queries as conditions_of
from app.records.page_queries import (
    MOST_BRANCHES,
    Branch,
    Key,
    all_studies,
    food_ids,
    participants_of,
    studies_of,
    within_days,
)
from app.records.streams import MealSearch, Stream

MOST_BY_ARRAYS = 2000  # branches of a statement on PostgreSQL, which plans them as one
MOST_LISTS = 2000  # different lists of flags in a study
# studies whose lists of flags are read; for more, meals are read in their order
MOST_STUDIES_FLAGGED = 64
SAMPLED = 1000  # meals of each filter that are sampled to find the rarest filter

Span = tuple[datetime | None, datetime | None]  # both included; None: no bound
ALWAYS: Span = (None, None)


@dataclass(frozen=True, slots=True)
class _Filter:
    """One filter. stream: its index in the page's order; None if there is none, or it has too many branches.

    of_meal: its conditions on the meal. of_record: its condition on one of the meal's records, given the entity.
    is_of_questions: it requires an open question.
    """

    stream: Stream | None
    of_meal: Conditions = ()
    of_record: Callable[[type[EffectiveRecord]], Condition] | None = None
    is_of_questions: bool = False


def search_of(
    session: Session, chosen: RowFilter, *, after: Key | None = None, is_newest_first: bool = True
) -> MealSearch | None:
    """Return the search for these filters; None if they match nothing that the caller may see.

    after, is_newest_first: the page to read; they affect the choice of the index, not the result.
    """
    studies = studies_of(session, chosen.study_code, chosen.study_ids)
    people = participants_of(session, chosen.participant_code, chosen.participant_id, studies)
    foods = food_ids(session, chosen.food_keys) if chosen.food_keys else None
    searched = studies if studies is not None else all_studies(session, MOST_BY_ARRAYS)
    if any(ids is not None and not ids for ids in (searched, people, foods)):
        return None
    is_on_sqlite = session.get_bind().dialect.name == "sqlite"
    of_studies = () if studies is None else (conditions_of.one_of_ids(Meal.study_id, studies),)
    filters = list(_filters(session, chosen, searched, foods, is_on_sqlite=is_on_sqlite))
    if any(each.stream is not None and not each.stream.branches for each in filters):
        return None
    read_filter, span = _all_of(searched, is_on_sqlite=is_on_sqlite), ALWAYS
    if people is not None:
        # a participant has some thousand meals: the other filters are checked for each
        read_filter = _Filter(
            Stream(Meal, (Meal.participant_id,), [(person,) for person in people])
        )
    elif any(each.stream is not None for each in filters):
        planner = _Planner(
            session, chosen, after, is_newest_first=is_newest_first, is_on_sqlite=is_on_sqlite
        )
        common = planner.common_span(filters)
        if common is None:
            return None
        span, read_filter = common, planner.rarest(filters, common)
    stream = read_filter.stream
    if stream is None:  # too many studies at once: their meals are sorted
        stream, of_others = Stream(Meal, (), [()], is_small=True), of_studies
    else:
        of_others = of_studies if read_filter.is_of_questions else ()
    rest = (
        *of_others,
        *_conditions(stream.model, [each for each in filters if each is not read_filter]),
    )
    return MealSearch(
        stream,
        (
            *within_days(chosen.first_day, chosen.last_day, stream.model),
            *_within(stream.model, span),
            *rest,
        ),
        is_on_sqlite,
    )


def keys_of(
    session: Session, search: MealSearch, after: Key | None, limit: int, *, is_newest_first: bool
) -> list[Key]:
    """Return the keys of a page, in its order."""
    page = search.page(after, limit, is_newest_first=is_newest_first)
    rows = session.execute(sa.select(page.c.captured_at, page.c.id))
    return sorted(((instant, meal_id) for instant, meal_id in rows), reverse=is_newest_first)


def _filters(
    session: Session,
    chosen: RowFilter,
    studies: Sequence[uuid.UUID],
    foods: Sequence[int] | None,
    *,
    is_on_sqlite: bool,
) -> Iterator[_Filter]:
    """Yield the filters other than study, participant and days."""
    record = EffectiveRecord

    def stream(
        model: type[Meal | EffectiveRecord],
        keys: tuple[AnyColumn, ...],
        *values: Sequence[object],
        part: Conditions = (),
    ) -> Stream | None:
        return _stream(
            model, keys, list(itertools.product(*values)), part, is_on_sqlite=is_on_sqlite
        )

    if chosen.statuses or chosen.origin is not None:
        statuses = sorted(set(chosen.statuses)) or MEAL_STATUSES
        origins = (chosen.origin,) if chosen.origin is not None else MEAL_ORIGINS
        keys = (Meal.study_id, Meal.status, Meal.origin)
        conditions = (
            [conditions_of.one_of_words(Meal.origin, origins)] if chosen.origin is not None else []
        )
        conditions += [conditions_of.one_of_words(Meal.status, statuses)] if chosen.statuses else []
        yield _Filter(stream(Meal, keys, studies, statuses, origins), of_meal=tuple(conditions))
    for column, values in (
        (Meal.failure_code, sorted(set(chosen.failure_codes))),
        (Meal.after_status, sorted(set(chosen.after_statuses))),
    ):
        if values:
            by_code = stream(
                Meal, (Meal.study_id, column), studies, values, part=(column.is_not(None),)
            )
            yield _Filter(by_code, of_meal=(conditions_of.one_of_words(column, values),))
    if foods is not None:
        by_food = stream(
            record,
            (record.food_id, record.study_id),
            foods,
            studies,
            part=(conditions_of.holds(record),),
        )
        yield _Filter(
            by_food, of_record=lambda entity: conditions_of.one_of_numbers(entity.food_id, foods)
        )
    if chosen.flags:
        yield _flagged(session, chosen, studies, is_on_sqlite=is_on_sqlite)
    if chosen.needs == "review":
        to_review = stream(
            record, (record.study_id,), studies, part=conditions_of.needs_look(record)
        )
        yield _Filter(
            to_review, of_record=lambda entity: sa.and_(*conditions_of.needs_look(entity))
        )
    if chosen.needs == "answer":
        questions = Stream(
            Meal,
            (),
            [()],
            (conditions_of.was_asked(), conditions_of.waits_for_answer(Meal.id)),
            True,
        )
        yield _Filter(questions, is_of_questions=True)


def _flagged(
    session: Session, chosen: RowFilter, studies: Sequence[uuid.UUID], *, is_on_sqlite: bool
) -> _Filter:
    """Return the filter of flags; its index is by whole lists of flags, of which those with one of the flags count."""
    record, flags = EffectiveRecord, sorted(set(chosen.flags))
    without_index = _Filter(
        None,
        of_record=lambda entity: conditions_of.has_flag(
            entity.flags, flags, is_on_sqlite=is_on_sqlite
        ),
    )
    if len(studies) > MOST_STUDIES_FLAGGED:
        return without_index
    branches = []
    for study in studies:
        lists = conditions_of.lists_of_flags(session, study, MOST_LISTS + 1)
        if len(lists) > MOST_LISTS:
            return without_index
        branches += [
            (study, listed)
            for listed in lists
            if not conditions_of.flags_in(listed).isdisjoint(flags)
        ]
    part = (conditions_of.holds(record), conditions_of.has_flags(record))
    stream = _stream(
        record, (record.study_id, record.flags), branches, part, is_on_sqlite=is_on_sqlite
    )
    return replace(without_index, stream=stream)


def _stream(
    model: type[Meal | EffectiveRecord],
    keys: tuple[AnyColumn, ...],
    branches: Sequence[Branch],
    part: Conditions,
    *,
    is_on_sqlite: bool,
) -> Stream | None:
    most = MOST_BRANCHES if is_on_sqlite else MOST_BY_ARRAYS
    return Stream(model, keys, branches, part) if len(branches) <= most else None


def _all_of(studies: Sequence[uuid.UUID], *, is_on_sqlite: bool) -> _Filter:
    """Return the filter that only restricts the studies."""
    return _Filter(
        _stream(
            Meal, (Meal.study_id,), [(study,) for study in studies], (), is_on_sqlite=is_on_sqlite
        )
    )


@dataclass(frozen=True, slots=True)
class _Planner:
    """Chooses the filter from whose index a page is read."""

    session: Session
    chosen: RowFilter
    after: Key | None
    is_newest_first: bool
    is_on_sqlite: bool

    def common_span(self, filters: Sequence[_Filter]) -> Span | None:
        """Return the span of time in which every filter has meals; None if there is none.

        Meals that wait for a reviewer are new, failed ones may be of a single week: others need not be checked.
        """
        streams = [each.stream for each in filters if each.stream is not None]
        if len(streams) <= 1:
            return ALWAYS
        first, last = ALWAYS
        for stream in streams:
            since, until = self.session.execute(self._of_days(stream).ends()).one()
            if since is None or until is None:
                return None
            first = since if first is None else max(first, since)
            last = until if last is None else min(last, until)
        return (first, last) if first is None or last is None or first <= last else None

    def rarest(self, filters: Sequence[_Filter], span: Span) -> _Filter:
        """Return the filter with the fewest entries after the page's start, or with the widest spacing of entries."""
        readable = [(each, each.stream) for each in filters if each.stream is not None]
        if len(readable) == 1:
            return readable[0][0]
        sampled = []
        for place, (_, stream) in enumerate(readable):
            search = self._of_days(stream, *_within(stream.model, span))
            query = search.sample(self.after, SAMPLED, is_newest_first=self.is_newest_first)
            count, reach = self.session.execute(query).one()
            seconds = reach.timestamp() if reach is not None else 0.0
            sampled.append((count, seconds if self.is_newest_first else -seconds, place))
        return readable[min(sampled)[2]][0]

    def _of_days(self, stream: Stream, *conditions: Condition) -> MealSearch:
        return MealSearch(
            stream,
            (*within_days(self.chosen.first_day, self.chosen.last_day, stream.model), *conditions),
            self.is_on_sqlite,
        )


def _within(model: type[Meal | EffectiveRecord], span: Span) -> Iterator[Condition]:
    first, last = span
    if first is not None:
        yield model.captured_at >= first
    if last is not None:
        yield model.captured_at <= last


def _conditions(
    model: type[Meal | EffectiveRecord], filters: Sequence[_Filter]
) -> Iterator[Condition]:
    """Yield the conditions of filters on an entry of another filter's index."""
    meal_id = Meal.id if model is Meal else EffectiveRecord.meal_id
    of_meal = [condition for each in filters for condition in each.of_meal]
    if of_meal and model is Meal:
        yield from of_meal
    elif of_meal:
        yield conditions_of.meal_is(meal_id, of_meal)
    for checked in filters:
        if checked.of_record is not None:
            yield conditions_of.has_record(meal_id, checked.of_record)
        if checked.is_of_questions:
            yield conditions_of.waits_for_answer(meal_id)
