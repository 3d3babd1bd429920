"""Which meals are on a page: their keys (captured_at, id), found in indexes whatever the filters, either way round.

Each filter has an index in which its meals stand in the page's order: of the meals themselves (study, status and
origin, failure, after-meal pair, participant) or of their records (food, flags, not reviewed). The page is read along
one of them, the one with the fewest meals, and what the other filters ask is looked up meal by meal; so a rare filter
beside a common one is quick, and one that leaves nothing costs nothing. docs/capacity.md tells which index serves what.
"""

import itertools
import uuid
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime, time
from typing import Any

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.statements import AnyColumn, Condition, Conditions
from app.http.row_filter import RowFilter
from app.meals.models import MEAL_ORIGINS, MEAL_STATUSES, Meal
from app.meals.record_models import EffectiveRecord
from app.records import conditions as conditions_of
from app.records.page_queries import (
    CALENDAR,
    EASTERNMOST,
    LATEST_END,
    MOST_BRANCHES,
    Branch,
    Key,
    all_studies,
    food_ids,
    participants_of,
    studies_of,
)
from app.records.streams import MealSearch, Stream

MOST_BY_ARRAYS = 2000  # branches of one statement of PostgreSQL, which plans them as one
MOST_LISTS = 2000  # of flags in a study, and
MOST_STUDIES_FLAGGED = 64  # studies in which they are looked up; with more the meals are read in their order
SAMPLED = 1000  # meals of each filter are looked at, to read along the one that has the fewest

Span = tuple[datetime | None, datetime | None]  # both included; None: no bound
ALWAYS: Span = (None, None)


@dataclass(frozen=True, slots=True)
class _Asked:
    """What one filter asks. stream: where its meals stand in order; None: nowhere, or in too many branches.

    of_meal: of the meal itself. of_record: of one of its records, given the
    entity. is_of_questions: that one is open.
    """

    stream: Stream | None
    of_meal: Conditions = ()
    of_record: Callable[[type[EffectiveRecord]], Condition] | None = None
    is_of_questions: bool = False


def search_of(
    session: Session, chosen: RowFilter, *, after: Key | None = None, is_newest_first: bool = True
) -> MealSearch | None:
    """The filter as it is searched for; None: it names what is not there, or what the caller may not see.

    after, is_newest_first: the page to be read; they change which index is read along, not what is found.
    """
    studies = studies_of(session, chosen.study_code, chosen.study_ids)
    people = participants_of(session, chosen.participant_code, chosen.participant_id, studies)
    foods = food_ids(session, chosen.food_keys) if chosen.food_keys else None
    searched = studies if studies is not None else all_studies(session, MOST_BY_ARRAYS)
    if any(found is not None and not found for found in (searched, people, foods)):
        return None
    is_on_sqlite = session.get_bind().dialect.name == "sqlite"
    of_studies = () if studies is None else (conditions_of.one_of_ids(Meal.study_id, studies),)
    asked = list(_asked(session, chosen, searched, foods, is_on_sqlite=is_on_sqlite))
    if any(one.stream is not None and not one.stream.branches for one in asked):
        return None
    along, span = _all_of(searched, is_on_sqlite=is_on_sqlite), ALWAYS
    if people is not None:
        # a person has some thousand meals: what else is asked is looked up at each
        along = _Asked(Stream(Meal, (Meal.participant_id,), [(person,) for person in people]))
    elif any(one.stream is not None for one in asked):
        search = _Searching(session, chosen, after, is_newest_first=is_newest_first, is_on_sqlite=is_on_sqlite)
        common = search.common_span(asked)
        if common is None:
            return None
        span, along = common, search.rarest(asked, common)
    stream = along.stream
    if stream is None:  # too many studies at once: their meals are sorted
        stream, of_others = Stream(Meal, (), [()], is_small=True), of_studies
    else:
        of_others = of_studies if along.is_of_questions else ()
    rest = (*of_others, *_looked_up(stream.model, [one for one in asked if one is not along]))
    return MealSearch(stream, (*within_days(stream.model, chosen), *_within(stream.model, span), *rest), is_on_sqlite)


def pages_of_keys(
    session: Session, chosen: RowFilter, *, size: int = 1000, is_newest_first: bool = False
) -> Iterator[list[Key]]:
    """All meals of a filter, page by page, each in its order: what an export reads on, in its one transaction."""
    search = search_of(session, chosen, is_newest_first=is_newest_first)
    after: Key | None = None
    while search is not None:
        keys = keys_of(session, search, after, size, is_newest_first=is_newest_first)
        if keys:
            yield keys
        if len(keys) < size:
            return
        after = keys[-1]


def keys_of(session: Session, search: MealSearch, after: Key | None, limit: int, *, is_newest_first: bool) -> list[Key]:
    """The keys of one page, in its order."""
    page = search.page(after, limit, is_newest_first=is_newest_first)
    found = session.execute(sa.select(page.c.captured_at, page.c.id))
    return sorted(((instant, meal) for instant, meal in found), reverse=is_newest_first)


def within_days(model: type[Meal | EffectiveRecord], chosen: RowFilter) -> Conditions:
    """The local days exactly, and bounds of the instant around them, by which an index is entered and left."""
    earliest, latest = CALENDAR
    found: list[Condition] = []
    if chosen.first_day is not None:
        found.append(model.local_date >= chosen.first_day)
        if earliest < chosen.first_day < latest:
            found.append(model.captured_at >= _midnight(chosen.first_day) - EASTERNMOST)
    if chosen.last_day is not None:
        found.append(model.local_date <= chosen.last_day)
        if earliest < chosen.last_day < latest:
            found.append(model.captured_at < _midnight(chosen.last_day) + LATEST_END)
    return tuple(found)


def _asked(
    session: Session,
    chosen: RowFilter,
    studies: Sequence[uuid.UUID],
    foods: Sequence[int] | None,
    *,
    is_on_sqlite: bool,
) -> Iterator[_Asked]:
    """Each filter beside study, participant and days."""
    record = EffectiveRecord

    def stream(
        model: type[Meal | EffectiveRecord], keys: tuple[AnyColumn, ...], *values: Sequence[Any], part: Conditions = ()
    ) -> Stream | None:
        return _stream(model, keys, list(itertools.product(*values)), part, is_on_sqlite=is_on_sqlite)

    if chosen.statuses or chosen.origin is not None:
        statuses = sorted(set(chosen.statuses)) or MEAL_STATUSES
        origins = (chosen.origin,) if chosen.origin is not None else MEAL_ORIGINS
        keys = (Meal.study_id, Meal.status, Meal.origin)
        conditions = [conditions_of.one_of_words(Meal.origin, origins)] if chosen.origin is not None else []
        conditions += [conditions_of.one_of_words(Meal.status, statuses)] if chosen.statuses else []
        yield _Asked(stream(Meal, keys, studies, statuses, origins), of_meal=tuple(conditions))
    for column, values in (
        (Meal.failure_code, sorted(set(chosen.failure_codes))),
        (Meal.after_status, sorted(set(chosen.after_statuses))),
    ):
        if values:
            known = stream(Meal, (Meal.study_id, column), studies, values, part=(column.is_not(None),))
            yield _Asked(known, of_meal=(conditions_of.one_of_words(column, values),))
    if foods is not None:
        known = stream(record, (record.food_id, record.study_id), foods, studies, part=(conditions_of.holds(record),))
        yield _Asked(known, of_record=lambda its: conditions_of.one_of_numbers(its.food_id, foods))
    if chosen.flags:
        yield _flagged(session, chosen, studies, is_on_sqlite=is_on_sqlite)
    if chosen.needs == "review":
        part = (conditions_of.holds(record), record.reviewed.is_(False))
        known = stream(record, (record.study_id,), studies, part=part)
        yield _Asked(known, of_record=lambda its: its.reviewed.is_(False))
    if chosen.needs == "answer":
        asked = Stream(Meal, (), [()], (conditions_of.was_asked(), conditions_of.waits_for_answer(Meal.id)), True)
        yield _Asked(asked, is_of_questions=True)


def _flagged(session: Session, chosen: RowFilter, studies: Sequence[uuid.UUID], *, is_on_sqlite: bool) -> _Asked:
    """An index by whole lists of flags: of the lists that a study's records have, those with one of the flags."""
    record, flags = EffectiveRecord, sorted(set(chosen.flags))
    asked = _Asked(None, of_record=lambda its: conditions_of.has_flag(its.flags, flags, is_on_sqlite=is_on_sqlite))
    if len(studies) > MOST_STUDIES_FLAGGED:
        return asked
    branches = []
    for study in studies:
        lists = conditions_of.lists_of_flags(session, study, MOST_LISTS + 1)
        if len(lists) > MOST_LISTS:
            return asked
        branches += [(study, listed) for listed in lists if not conditions_of.flags_in(listed).isdisjoint(flags)]
    part = (conditions_of.holds(record), conditions_of.has_flags(record))
    stream = _stream(record, (record.study_id, record.flags), branches, part, is_on_sqlite=is_on_sqlite)
    return replace(asked, stream=stream)


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


def _all_of(studies: Sequence[uuid.UUID], *, is_on_sqlite: bool) -> _Asked:
    """Nothing but studies is asked."""
    return _Asked(_stream(Meal, (Meal.study_id,), [(study,) for study in studies], (), is_on_sqlite=is_on_sqlite))


@dataclass(frozen=True, slots=True)
class _Searching:
    """Which of several filters to read along, for one page."""

    session: Session
    chosen: RowFilter
    after: Key | None
    is_newest_first: bool
    is_on_sqlite: bool

    def common_span(self, asked: Sequence[_Asked]) -> Span | None:
        """From when to when there are meals of each filter; None: of one there are none, or they never meet.

        What waits for a reviewer is new, what failed may be of one bad week: outside it nothing need be looked up.
        """
        streams = [one.stream for one in asked if one.stream is not None]
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

    def rarest(self, asked: Sequence[_Asked], span: Span) -> _Asked:
        """The filter with the fewest entries behind the page's place, or whose entries lie the farthest apart."""
        readable = [(one, one.stream) for one in asked if one.stream is not None]
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
        return MealSearch(stream, (*within_days(stream.model, self.chosen), *conditions), self.is_on_sqlite)


def _within(model: type[Meal | EffectiveRecord], span: Span) -> Iterator[Condition]:
    first, last = span
    if first is not None:
        yield model.captured_at >= first
    if last is not None:
        yield model.captured_at <= last


def _looked_up(model: type[Meal | EffectiveRecord], others: Sequence[_Asked]) -> Iterator[Condition]:
    """What the other filters ask, of an entry of the index that is read along."""
    meal_id = Meal.id if model is Meal else EffectiveRecord.meal_id
    of_meal = [condition for one in others for condition in one.of_meal]
    if of_meal and model is Meal:
        yield from of_meal
    elif of_meal:
        yield conditions_of.meal_is(meal_id, of_meal)
    for one in others:
        if one.of_record is not None:
            yield conditions_of.has_record(meal_id, one.of_record)
        if one.is_of_questions:
            yield conditions_of.waits_for_answer(meal_id)


def _midnight(day: date) -> datetime:
    return datetime.combine(day, time(), UTC)
