"""Which records are on a page: their keys (captured_at, item id), found in indexes alone, whatever the filters.

The filters are resolved to ids first (study, participant, food). Each combination of ids that an
index begins with is a branch, in which the index holds the rows in the page's order already; the
branches are merged and the merge stops with the page. So a page costs the same at the start, in the
middle and at the end, and a filter that leaves nothing costs nothing. What the rows are joined with
is read for the page alone.

Lists of meals read along one index, too; each condition on a meal, its records or its events is
looked up at the meals found there. So that no planner turns it into a search, columns are compared
through coalesce, which no index serves, and what is of another table is a scalar subquery, which
neither database joins: it is read by the meal's id, as often as the page needs.
"""

import itertools
import json
import math
import uuid
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta
from typing import Any, cast

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql
from sqlalchemy.orm import Session, aliased

from app.db.statements import AnyColumn, AnyQuery, Condition, Conditions
from app.foods.models import Food
from app.http.row_filter import RowFilter
from app.meals.stored.event_models import MealEvent
from app.meals.stored.models import Meal
from app.meals.stored.record_models import RECORD_STATUSES, EffectiveRecord
from app.people.models import Participant, Study
from app.people.queries import sandboxes

MOST_BRANCHES = 256  # of one statement; with more the records are read in their order, and those of no branch passed by
EASTERNMOST = timedelta(hours=14)  # a local day begins so long before the same day of UTC
# A local day ends so long after the same day of UTC has begun: the day itself, 12 h in the westernmost zone, 24 h where
# the study's day starts late, and 24 h where a zone moved over the date line and has no such day (services/meal_time).
LATEST_END = timedelta(days=3, hours=12)
CALENDAR = (date(1900, 1, 1), date(9000, 1, 1))  # days beyond bound nothing: no record is there

MOST_PLANNED = 8  # PostgreSQL plans each branch by itself, in half a millisecond; more of them are given as arrays
ORDER = (EffectiveRecord.captured_at, EffectiveRecord.item_id)
NAMED_ORDER: tuple[AnyColumn, AnyColumn] = (
    sa.literal_column("captured_at"),
    sa.literal_column("item_id"),
)

Key = tuple[datetime, uuid.UUID]
Branch = tuple[object, ...]  # a value of each key column


@dataclass(frozen=True, slots=True)
class RecordSearch:
    """A filter whose names are ids: the branches to read, and what each row of them must fulfil besides.

    keys: the columns that a branch has values of. PostgreSQL keeps an index's order in a branch
    only if the branch has an order and a limit of its own (else it reads all of each and sorts);
    SQLite merges branches as they are, and would sort each that has a limit.
    """

    keys: tuple[AnyColumn, ...]
    branches: Sequence[Branch]
    conditions: Conditions
    is_on_sqlite: bool

    def page(self, after: Key | None, limit: int | None) -> sa.CTE:
        """At most `limit` records behind `after` (None: all): captured_at and item_id.

        In no order: the reader sorts what it has joined them with.
        """
        conditions = self.conditions if after is None else (*self.conditions, behind(*after))
        statement = sa.select(*ORDER).where(*conditions)
        if self.is_on_sqlite or len(self.branches) <= MOST_PLANNED:
            parts = [
                statement.where(
                    *(key == value for key, value in zip(self.keys, values, strict=True))
                )
                for values in self.branches
            ]
            if not self.is_on_sqlite:
                parts = [sa.select(part.order_by(*ORDER).limit(limit).subquery()) for part in parts]
            every = sa.select(sa.union_all(*parts).subquery("branch"))
        else:  # PostgreSQL: one plan for however many branches, each of which gives a page
            names = [f"key_{number}" for number in range(len(self.keys))]
            columns = zip(self.keys, zip(*self.branches, strict=True), strict=True)
            arrays = (
                sa.literal(list(values), postgresql.ARRAY(key.type)) for key, values in columns
            )
            listed = sa.func.unnest(*arrays).table_valued(*names).render_derived("listed")
            of_branch = (key == listed.c[name] for key, name in zip(self.keys, names, strict=True))
            branch = statement.where(*of_branch).order_by(*ORDER).limit(limit).lateral("branch")
            every = sa.select(branch).select_from(listed.join(branch, sa.true()))
        return every.order_by(*NAMED_ORDER).limit(limit).cte("page")


def search_of(session: Session, chosen: RowFilter) -> RecordSearch | None:
    """The filter as it is searched for; None: it names what is not there, or what the caller may not see."""
    record = EffectiveRecord
    studies = studies_of(session, chosen.study_code, chosen.study_ids)
    people = participants_of(session, chosen.participant_code, chosen.participant_id, studies)
    foods = food_ids(session, chosen.food_keys) if chosen.food_keys else None
    statuses = sorted(set(chosen.statuses)) or None
    if any(ids is not None and not ids for ids in (studies, people, foods)):
        return None
    days = within_days(chosen.first_day, chosen.last_day)
    of_food, of_status = _one_of(record.food_id, foods), _one_of(record.status, statuses)
    by: list[tuple[AnyColumn, Sequence[object]]] = []
    if people is not None:
        by, rest = [(record.participant_id, people)], (*of_food, *of_status, *days)
    elif foods is not None:
        searched = studies if studies is not None else all_studies(session)
        by = [
            (record.food_id, foods),
            (record.study_id, searched),
            (record.status, statuses or RECORD_STATUSES),
        ]
        rest = days
    elif statuses is not None:
        searched = studies if studies is not None else all_studies(session)
        by, rest = [(record.study_id, searched), (record.status, statuses)], days
    elif studies is not None:
        by, rest = [(record.study_id, studies)], days
    else:
        rest = days
    if math.prod(len(values) for _, values in by) > MOST_BRANCHES:
        of_study, of_person = (
            _one_of(record.study_id, studies),
            _one_of(record.participant_id, people),
        )
        by, rest = [], (*of_study, *of_person, *of_food, *of_status, *days)
    branches = list(itertools.product(*(values for _, values in by)))
    keys = tuple(column for column, _ in by)
    is_on_sqlite = session.get_bind().dialect.name == "sqlite"
    return RecordSearch(keys, branches, rest, is_on_sqlite) if branches else None


def studies_of(
    session: Session, study_code: str | None, study_ids: frozenset[uuid.UUID] | None
) -> list[uuid.UUID] | None:
    """The studies that a filter and the caller's own leave; None: all there are.

    A sandbox study counts only if it is named, or the only one of the caller: nobody takes its
    meals for a study's.
    """
    if study_code is None:
        if study_ids is not None and len(study_ids) == 1:
            return list(study_ids)
        hidden = sandboxes(session)
        if study_ids is None:
            return (
                sorted(session.scalars(sa.select(Study.id).where(~Study.is_sandbox)))
                if hidden
                else None
            )
        return sorted(study_ids - hidden)
    ids = session.scalars(sa.select(Study.id).where(Study.code == study_code))
    return [study for study in ids if study_ids is None or study in study_ids]


def all_studies(session: Session, most: int = MOST_BRANCHES) -> list[uuid.UUID]:
    """The ids of all studies, or of one more than `most`, the most branches that the caller's statement may have."""
    return list(session.scalars(sa.select(Study.id).order_by(Study.id).limit(most + 1)))


def participants_of(
    session: Session,
    code: str | None,
    participant_id: uuid.UUID | None,
    studies: Sequence[uuid.UUID] | None,
) -> list[uuid.UUID] | None:
    """The participants of this code or id in these studies (None: in all); None: neither is asked for."""
    if code is None and participant_id is None:
        return None
    # through the studies, which are few: there is no index of codes alone
    query = (
        sa.select(Participant.id)
        .join(Study, Study.id == Participant.study_id)
        .order_by(Participant.id)
    )
    if code is not None:
        query = query.where(Participant.code == code)
    if participant_id is not None:
        query = query.where(Participant.id == participant_id)
    if studies is not None:
        query = query.where(Study.id.in_(studies))
    return list(session.scalars(query))


def food_ids(session: Session, keys: Sequence[str]) -> list[int]:
    """The ids of all versions of these foods, in all releases."""
    return list(session.scalars(sa.select(Food.id).where(Food.key.in_(keys)).order_by(Food.id)))


def within_days(
    first_day: date | None,
    last_day: date | None,
    model: type[Meal | EffectiveRecord] = EffectiveRecord,
) -> Conditions:
    """The local days exactly, and bounds of the instant around them, by which an index is entered and left.

    The days stand in a CASE, which PostgreSQL takes for true of every second row. It would
    otherwise multiply the shares of rows that fulfil the day and the instant, though these are
    nearly the same ones, expect next to none, and read all rows of the span and sort them, rather
    than those of the page in the index's order.
    """
    earliest, latest = CALENDAR
    conditions: list[sa.ColumnElement[bool]] = []
    days: list[sa.ColumnElement[bool]] = []
    if first_day is not None:
        days.append(model.local_date >= first_day)
        if earliest < first_day < latest:
            conditions.append(model.captured_at >= _midnight(first_day) - EASTERNMOST)
    if last_day is not None:
        days.append(model.local_date <= last_day)
        if earliest < last_day < latest:
            conditions.append(model.captured_at < _midnight(last_day) + LATEST_END)
    if days:
        conditions.append(sa.case((sa.and_(*days), sa.true()), else_=sa.false()))
    return tuple(conditions)


def _midnight(day: date) -> datetime:
    return datetime.combine(day, time(), UTC)


def _one_of(column: AnyColumn, values: Sequence[object] | None) -> Conditions:
    return (column.in_(values),) if values is not None else ()


def behind(captured_at: datetime, item_id: uuid.UUID) -> sa.ColumnElement[bool]:
    """Whether a record comes after this key, in the order of pages."""
    record = EffectiveRecord
    key = sa.tuple_(
        sa.bindparam(None, captured_at, type_=record.captured_at.type),
        sa.bindparam(None, item_id, type_=record.item_id.type),
    )
    return sa.tuple_(record.captured_at, record.item_id) > key


NO_ID = uuid.UUID(int=0)


def holds(record: type[EffectiveRecord]) -> Condition:
    """The record counts: nobody has rejected it.

    A literal, as partial indexes have it: planners see no parameters.
    """
    return record.status != sa.literal_column("'rejected'")


def needs_look(record: type[EffectiveRecord]) -> Conditions:
    """A reviewer should look at the item: none has settled it, and it is no text entry that is complete.

    Overview, meals, review queue, exports and API all count by it. Literals, as in the partial
    indexes.
    """
    is_no_text = record.origin != sa.literal_column("'declared'")
    is_incomplete = record.status == sa.literal_column("'needs_review'")
    return (holds(record), record.reviewed.is_(False), sa.or_(is_no_text, is_incomplete))


def has_flags(record: type[EffectiveRecord]) -> Condition:
    """The record has any flag, as the partial index has it."""
    return cast(Condition, record.flags.op("<>", is_comparison=True)(sa.literal_column("'[]'")))


def is_question(event: type[MealEvent]) -> Condition:
    """As the partial index has it."""
    return event.kind == sa.literal_column("'question'")


def one_of_words(column: AnyColumn, values: Collection[str]) -> Condition:
    """A column of text has one of these values."""
    return sa.func.coalesce(column, "").in_(values)


def one_of_numbers(column: AnyColumn, values: Collection[int]) -> Condition:
    """A column of numbers has one of these values, all above 0."""
    return sa.func.coalesce(column, 0).in_(values)


def one_of_ids(column: AnyColumn, values: Collection[uuid.UUID]) -> Condition:
    """A column of ids has one of these values."""
    return sa.func.coalesce(column, sa.literal(NO_ID, column.type), type_=column.type).in_(values)


def meal_is(meal_id: AnyColumn, conditions: Iterable[Condition]) -> Condition:
    """The meal of this id fulfils conditions on Meal."""
    return _is_there(sa.select(sa.literal(1)).where(Meal.id == meal_id, *conditions))


def has_record(
    meal_id: AnyColumn, asked: Callable[[type[EffectiveRecord]], Condition]
) -> Condition:
    """One record of the meal holds and is as asked of EffectiveRecord, or of an alias of it."""
    record = aliased(EffectiveRecord)
    return _is_there(
        sa.select(sa.literal(1)).where(record.meal_id == meal_id, holds(record), asked(record))
    )


def was_asked() -> Condition:
    """The participant was ever asked about the meal; an index has these meals, which are few."""
    return Meal.id.in_(sa.select(MealEvent.meal_id).where(is_question(MealEvent)))


def waits_for_answer(meal_id: AnyColumn) -> Condition:
    """A question to the participant is neither answered nor taken back, as services/review_queue has it.

    An answer that was taken back leaves its question open.
    """
    question, reply, undo = aliased(MealEvent), aliased(MealEvent), aliased(MealEvent)
    is_taken_back = sa.exists().where(
        undo.meal_id == question.meal_id, undo.kind == "undo", _names(undo, "event", question)
    )
    is_answer_taken_back = sa.exists().where(
        undo.meal_id == reply.meal_id, undo.kind == "undo", _names(undo, "event", reply)
    )
    is_answered = sa.exists().where(
        reply.meal_id == question.meal_id, reply.kind == "answer", _names(reply, "question", question),
        ~is_answer_taken_back,
    )  # fmt: skip
    questions = sa.select(sa.literal(1)).where(question.meal_id == meal_id, is_question(question))
    return _is_there(questions.where(~is_taken_back, ~is_answered))


def has_flag(column: AnyColumn, flags: Sequence[str], *, is_on_sqlite: bool) -> Condition:
    """A list of flags has one of these."""
    if is_on_sqlite:
        text = sa.type_coerce(column, sa.Text())
        return sa.or_(*(sa.func.instr(text, json.dumps(flag)) > 0 for flag in flags))
    wanted_flags = sa.literal(list(flags), postgresql.ARRAY(sa.Text()))
    return cast(Condition, sa.type_coerce(column, postgresql.JSONB()).has_any(wanted_flags))


def is_list_of_flags(column: AnyColumn, text: str | AnyColumn, *, is_on_sqlite: bool) -> Condition:
    """A list of flags is this one, given as text as lists_of_flags has it."""
    is_it: Condition = sa.type_coerce(column, sa.Text()) == text
    if not is_on_sqlite:
        kept = sa.cast(
            sa.literal(text, sa.Text()) if isinstance(text, str) else text, postgresql.JSONB()
        )
        is_it = sa.type_coerce(column, postgresql.JSONB()) == kept
    return is_it


def lists_of_flags(session: Session, study_id: uuid.UUID, most: int) -> list[str]:
    """The different lists of flags that records of a study have, as text, at most so many.

    Each is found behind the one before it in the index, so the cost is that of the lists, not of
    the records.
    """
    is_on_sqlite = session.get_bind().dialect.name == "sqlite"
    kind: Any = sa.Text() if is_on_sqlite else postgresql.JSONB()
    record = EffectiveRecord
    flags = sa.type_coerce(record.flags, kind).label("flags")
    flag_lists = sa.select(flags).where(
        record.study_id == study_id, holds(record), has_flags(record)
    )
    lists = flag_lists.order_by(record.flags).limit(1).subquery()
    every = sa.select(lists.c.flags).cte("every", recursive=True)
    behind = (
        flag_lists.where(sa.type_coerce(record.flags, kind) > every.c.flags)
        .order_by(record.flags)
        .limit(1)
    )
    following = behind.correlate(every).scalar_subquery()
    every = every.union_all(sa.select(following).where(every.c.flags.is_not(None)))
    as_text: Any = every.c.flags if is_on_sqlite else sa.cast(every.c.flags, sa.Text())
    query = sa.select(as_text).where(every.c.flags.is_not(None)).limit(most)
    return list(session.scalars(query))


def flags_in(text: str) -> frozenset[str]:
    """The flags of one of these lists."""
    return frozenset(json.loads(text))


def _names(event: type[MealEvent], key: str, other: type[MealEvent]) -> Condition:
    """The event's new value names the other event; ids stand in it with hyphens, in SQLite's columns without."""
    named = sa.func.replace(event.new[key].as_string(), "-", "")
    return named == sa.func.replace(sa.cast(other.id, sa.String()), "-", "")


def _is_there(query: AnyQuery) -> Condition:
    """A scalar, not EXISTS: PostgreSQL makes a join of that, which may read a whole table for a page."""
    return query.limit(1).scalar_subquery().is_not(None)
