"""What a filter asks of a meal, its records and its events, written so that no planner turns it into a search.

meal_pages reads along one index; each of these conditions is to be looked up at the meals found there. So columns are
compared through coalesce, which no index serves, and what is of another table is a scalar subquery, which neither
database joins: it is read by the meal's id, as often as the page needs.
"""

import json
import uuid
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Any, cast

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql
from sqlalchemy.orm import Session, aliased

from app.db.statements import AnyColumn, AnyQuery, Condition, Conditions
from app.meals.stored.event_models import MealEvent
from app.meals.stored.models import Meal
from app.meals.stored.record_models import EffectiveRecord

NO_ID = uuid.UUID(int=0)


def holds(record: type[EffectiveRecord]) -> Condition:
    """The record counts: nobody has rejected it. A literal, as partial indexes have it: planners see no parameters."""
    return record.status != sa.literal_column("'rejected'")


def needs_look(record: type[EffectiveRecord]) -> Conditions:
    """A reviewer should look at the item: none has settled it, and it is no text entry that is complete.

    Overview, meals, review queue, exports and API all count by it. Literals, as in the partial indexes.
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

    Each is found behind the one before it in the index, so the cost is that of the lists, not of the records.
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
