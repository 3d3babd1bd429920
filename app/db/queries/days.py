"""SQL of days: what meals and records come to, a row a participant-day.

The sums are the database's, over records that hold (not rejected) of meals that are there (not deleted). What is not
known is NULL, never 0, but on a day when nothing was eaten. Days page by (local_date, participant id).
"""

import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date, datetime
from typing import Any, Literal, NamedTuple

import sqlalchemy as sa
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.orm import Session
from sqlalchemy.sql.functions import FunctionElement

from app.db.models import DayEvent, DiaryDay, EffectiveRecord, Meal, Participant, Study
from app.db.models.record import HEADLINE_COLUMNS
from app.db.queries.record_pages import MOST_BRANCHES, all_studies, participants_of, studies_of

DayStatus = Literal["open", "closed"]
DayKey = tuple[date, uuid.UUID]  # local day, participant

SEEN = ("pipeline", "added", "split", "merged")  # origins of items that are in a meal's photographs
FULL = 1.0 - 1e-9  # a coverage of everything, but for rounding


@dataclass(frozen=True, slots=True)
class DayFilter:
    """Which days: None leaves a filter out. first_day and last_day are local days, both included."""

    study_code: str | None = None
    participant_code: str | None = None
    participant_id: uuid.UUID | None = None
    study_ids: frozenset[uuid.UUID] | None = None
    first_day: date | None = None
    last_day: date | None = None


class Amount(NamedTuple):
    """A day's sum of a component over the items where it is known, and for which share of the grams that is.

    value: None where it is known of no item. coverage: 0 to 1; None where grams of an item, or of a whole meal, are not
    known.
    """

    value: float | None
    coverage: float | None


@dataclass(frozen=True, slots=True)
class DayRow:
    """A participant's day.

    said_nothing: the word that nothing was eaten; it counts while there is no meal. version: 0 without a word.
    meals_after_closing: meals that came in after the day was closed. unmeasured_meals: of which no food is known, and
    nobody has said that there was none. unmeasured_items: whose eaten grams are not known. leftovers_unknown_items:
    those that count as eaten up since nobody has looked, where the study expects an after-meal pair.
    """

    participant_id: uuid.UUID
    participant_code: str
    study_code: str
    profile: dict[str, Any] | None
    local_date: date
    status: DayStatus
    said_nothing: bool
    version: int
    changed_at: datetime | None
    is_by_reviewer: bool
    meals: int
    meals_after_closing: int
    unmeasured_meals: int
    median_upload_delay_seconds: float | None
    items: int
    unmeasured_items: int
    provisional_items: int
    leftovers_unknown_items: int
    consumed_g: float | None
    amounts: Mapping[str, Amount]

    @property
    def ate_nothing(self) -> bool:
        """Closed, by the word that nothing was eaten, and no meal says otherwise."""
        return self.status == "closed" and self.said_nothing and self.meals == 0

    @property
    def is_nothing(self) -> bool:
        """Closed, and nothing was eaten: by that word, or since each meal was confirmed to be without food."""
        is_empty = self.meals > 0 and self.items == 0 and self.unmeasured_meals == 0
        return self.ate_nothing or (self.status == "closed" and is_empty)

    @property
    def is_complete(self) -> bool:
        """Closed, and the eaten grams of everything are known, and final: no after-meal pair is waited for."""
        is_measured = self.items > 0 and self.unmeasured_items == 0 and self.unmeasured_meals == 0
        return self.is_nothing or (self.status == "closed" and is_measured and self.provisional_items == 0)

    def amount(self, column: str) -> Amount:
        """One of HEADLINE_COLUMNS; a day when nothing was eaten has 0 of everything."""
        return Amount(0.0, 1.0) if self.is_nothing else self.amounts[column]


class seconds_between(FunctionElement[float]):  # noqa: N801  # named as the SQL function that it stands for
    """Seconds from the first instant to the second."""

    type = sa.Float()
    inherit_cache = True


@compiles(seconds_between, "postgresql")
def _seconds_postgresql(element: Any, compiler: Any, **options: Any) -> str:
    first, second = (compiler.process(clause, **options) for clause in element.clauses)
    return f"CAST(EXTRACT(EPOCH FROM ({second} - {first})) AS DOUBLE PRECISION)"


@compiles(seconds_between, "sqlite")
def _seconds_sqlite(element: Any, compiler: Any, **options: Any) -> str:
    first, second = (compiler.process(clause, **options) for clause in element.clauses)
    return f"ROUND((julianday({second}) - julianday({first})) * 86400.0, 3)"  # it counts milliseconds


def page_of_days(session: Session, chosen: DayFilter, *, after: DayKey | None, limit: int) -> list[DayRow]:
    """At most `limit` participant-days that have a meal or a word, in the order of (day, participant id)."""
    found = _page_keys(session, chosen, after, limit)
    if found is None:
        return []
    page = found.cte("page")
    return [
        _day_row(row)
        for row in session.execute(days_with_sums(page).order_by(page.c.local_date, page.c.participant_id))
    ]


def _page_keys(
    session: Session, chosen: DayFilter, after: DayKey | None, limit: int
) -> sa.Select[*tuple[Any, ...]] | None:
    """The first days behind `after`: those of each study, or participant, from an index that has them in this order.

    None: the filter names what is not there.
    """
    studies = studies_of(session, chosen.study_code, chosen.study_ids)
    people = participants_of(session, chosen.participant_code, chosen.participant_id, studies)
    ids = people if people is not None else studies if studies is not None else all_studies(session)
    if not ids:
        return None
    if len(ids) > MOST_BRANCHES // 2:
        return _first(keys_of(chosen, after).subquery(), limit)
    parts = []
    for table in (Meal, DiaryDay):
        column = table.participant_id if people is not None else table.study_id
        for one in ids:
            query = _within(sa.select(table.participant_id, table.local_date).distinct(), table, chosen, after)
            query = query.where(column == one).order_by(table.local_date, table.participant_id).limit(limit)
            each = query.subquery()  # a part with a limit of its own
            parts.append(sa.select(each.c.participant_id, each.c.local_date))
    return _first(sa.union(*parts).subquery(), limit)


def _first(keys: sa.Subquery, limit: int) -> sa.Select[*tuple[Any, ...]]:
    chosen = sa.select(keys.c.participant_id, keys.c.local_date)
    return chosen.order_by(keys.c.local_date, keys.c.participant_id).limit(limit)


def _within(
    query: sa.Select[*tuple[Any, ...]], table: type[Meal | DiaryDay], chosen: DayFilter, after: DayKey | None
) -> sa.Select[*tuple[Any, ...]]:
    """The days of a range, behind a key."""
    if chosen.first_day is not None:
        query = query.where(table.local_date >= chosen.first_day)
    if chosen.last_day is not None:
        query = query.where(table.local_date <= chosen.last_day)
    if after is not None:
        key = sa.tuple_(sa.literal(after[0], sa.Date()), sa.literal(after[1], sa.Uuid()))
        query = query.where(sa.tuple_(table.local_date, table.participant_id) > key)
    return query


def days_of(session: Session, chosen: DayFilter) -> list[DayRow]:
    """All days of the filter: for one participant, or a range that is bounded."""
    page = keys_of(chosen, None).cte("page")
    return [
        _day_row(row)
        for row in session.execute(days_with_sums(page).order_by(page.c.local_date, page.c.participant_id))
    ]


def find_day(session: Session, participant_id: uuid.UUID, local_date: date) -> DayRow | None:
    """One participant-day; None where nothing is known of it."""
    chosen = DayFilter(participant_id=participant_id, first_day=local_date, last_day=local_date)
    return next(iter(days_of(session, chosen)), None)


def keys_of(chosen: DayFilter, after: DayKey | None) -> sa.Select[*tuple[Any, ...]]:
    """The participant-days that have a meal or a word."""
    parts = []
    for table in (Meal, DiaryDay):
        query = sa.select(table.participant_id, table.local_date)
        query = filtered(query, table.study_id, table.participant_id, table.local_date, chosen)
        if after is not None:
            key = sa.tuple_(table.local_date, table.participant_id)
            query = query.where(key > sa.tuple_(sa.literal(after[0], sa.Date()), sa.literal(after[1], sa.Uuid())))
        parts.append(query)
    both = sa.union(*parts).subquery()
    return sa.select(both.c.participant_id, both.c.local_date)


def filtered(
    query: sa.Select[*tuple[Any, ...]], study_id: Any, participant_id: Any, local_date: Any, chosen: DayFilter
) -> sa.Select[*tuple[Any, ...]]:
    """The query with the filter's conditions on these columns of it."""
    if chosen.study_code is not None:
        query = query.where(study_id == sa.select(Study.id).where(Study.code == chosen.study_code).scalar_subquery())
    if chosen.participant_code is not None:
        query = query.where(
            participant_id.in_(sa.select(Participant.id).where(Participant.code == chosen.participant_code))
        )
    if chosen.participant_id is not None:
        query = query.where(participant_id == chosen.participant_id)
    if chosen.study_ids is not None:
        query = query.where(study_id.in_(chosen.study_ids))
    if chosen.first_day is not None:
        query = query.where(local_date >= chosen.first_day)
    if chosen.last_day is not None:
        query = query.where(local_date <= chosen.last_day)
    return query


def days_with_sums(page: sa.CTE) -> sa.Select[*tuple[Any, ...]]:
    """The days of a page with all that is told of them."""
    meals, delays, eaten = _meals_of(page), _delays_of(page), _records_of(page)
    by_reviewer = sa.exists().where(
        _same_day(DayEvent.participant_id, DayEvent.local_date, page), DayEvent.layer == "reviewer"
    )
    return (
        sa.select(
            page.c.participant_id,
            Participant.code.label("participant_code"),
            Study.code.label("study_code"),
            Participant.profile,
            page.c.local_date,
            sa.func.coalesce(DiaryDay.status, "open").label("status"),
            sa.func.coalesce(DiaryDay.ate_nothing, sa.false()).label("said_nothing"),
            sa.func.coalesce(DiaryDay.version, 0).label("version"),
            DiaryDay.changed_at,
            by_reviewer.label("by_reviewer"),
            sa.func.coalesce(meals.c.meals, 0).label("meals"),
            sa.func.coalesce(meals.c.late, 0).label("meals_after_closing"),
            sa.func.coalesce(meals.c.unmeasured_meals, 0).label("unmeasured_meals"),
            delays.c.median_seconds,
            sa.func.coalesce(eaten.c.item_count, 0).label("item_count"),
            sa.func.coalesce(eaten.c.unmeasured, 0).label("unmeasured"),
            sa.func.coalesce(eaten.c.provisional, 0).label("provisional"),
            sa.func.coalesce(eaten.c.leftovers_unknown, 0).label("leftovers_unknown"),
            eaten.c.consumed_g,
            *(eaten.c[column] for column in HEADLINE_COLUMNS),
            *(
                sa.case((sa.func.coalesce(meals.c.unmeasured_meals, 0) == 0, eaten.c[name])).label(name)
                for name in (f"{column}_coverage" for column in HEADLINE_COLUMNS)
            ),
        )
        .select_from(page)
        .join(Participant, Participant.id == page.c.participant_id)
        .join(Study, Study.id == Participant.study_id)
        .outerjoin(DiaryDay, _same_day(DiaryDay.participant_id, DiaryDay.local_date, page))
        .outerjoin(meals, _same_day(meals.c.participant_id, meals.c.local_date, page))
        .outerjoin(delays, _same_day(delays.c.participant_id, delays.c.local_date, page))
        .outerjoin(eaten, _same_day(eaten.c.participant_id, eaten.c.local_date, page))
    )


def coverage_of(amount: Any, consumed_g: Any) -> sa.ColumnElement[Any]:
    """The share of the eaten grams for which an amount is known; NULL where grams are not known.

    Differences below zero (more left than served, within the error) weigh nothing. Where nothing weighs anything, all
    was left: known of everything, or not.
    """
    weight_g = sa.case((consumed_g > 0.0, consumed_g), else_=0.0)
    known_g = sa.func.sum(sa.case((amount.is_not(None), weight_g), else_=0.0))
    unknown = sa.func.sum(sa.case((consumed_g.is_(None), 1), else_=0))
    of_nothing = sa.case((sa.func.count(amount) == sa.func.count(), 1.0), else_=0.0)
    of_what_was_eaten = known_g / sa.func.nullif(sa.func.sum(weight_g), 0.0)
    return sa.case((unknown == 0, sa.func.coalesce(of_what_was_eaten, of_nothing)))


def is_unmeasured_meal() -> sa.ColumnElement[bool]:
    """Whether no food is known of a meal (it failed, or is not measured yet) and nobody has confirmed that it is so."""
    has_food = sa.exists().where(EffectiveRecord.meal_id == Meal.id, EffectiveRecord.status != "rejected")
    return sa.and_(Meal.id.is_not(None), Meal.status != "confirmed", ~has_food)


def is_leftover_unknown() -> sa.ColumnElement[bool]:
    """Whether a record's eaten grams are all that was served since nobody has looked what was left, and should have.

    Of what was declared no camera sees what is left. For a query of records with their Meal and Study.
    """
    return sa.and_(
        Study.expects_after_pair,
        Meal.origin == "photographed",
        EffectiveRecord.origin.in_(SEEN),
        EffectiveRecord.consumed_g.is_not(None),
        EffectiveRecord.left_g.is_(None),
    )


# The page stands first in each of these, joined by LEFT JOIN: SQLite, which does not know how few its rows are, would
# read all meals and records otherwise.
def _meals_of(page: sa.CTE) -> sa.Subquery:
    is_late = sa.and_(DiaryDay.status == "closed", Meal.received_at > DiaryDay.changed_at)
    return (
        sa.select(
            page.c.participant_id,
            page.c.local_date,
            sa.func.count(Meal.id).label("meals"),
            sa.func.sum(sa.case((is_late, 1), else_=0)).label("late"),
            sa.func.sum(sa.case((is_unmeasured_meal(), 1), else_=0)).label("unmeasured_meals"),
        )
        .select_from(page)
        .outerjoin(Meal, _same_day(Meal.participant_id, Meal.local_date, page))
        .outerjoin(DiaryDay, _same_day(DiaryDay.participant_id, DiaryDay.local_date, page))
        .group_by(page.c.participant_id, page.c.local_date)
        .subquery()
    )


def _delays_of(page: sa.CTE) -> sa.Subquery:
    """The median delay from eating to arrival: SQLite knows no median, so the one or two in the middle are averaged."""
    delay = seconds_between(Meal.captured_at, Meal.received_at)
    of_day = (page.c.participant_id, page.c.local_date)
    ranked = (
        sa.select(
            page.c.participant_id,
            page.c.local_date,
            delay.label("seconds"),
            sa.func.row_number().over(partition_by=of_day, order_by=(delay, Meal.id)).label("place"),
            sa.func.count().over(partition_by=of_day).label("places"),
        )
        .select_from(page)
        .outerjoin(Meal, _same_day(Meal.participant_id, Meal.local_date, page))
        .subquery()
    )
    twice = 2 * ranked.c.place
    return (
        sa.select(ranked.c.participant_id, ranked.c.local_date, sa.func.avg(ranked.c.seconds).label("median_seconds"))
        .where(twice.between(ranked.c.places, ranked.c.places + 2))
        .group_by(ranked.c.participant_id, ranked.c.local_date)
        .subquery()
    )


def _records_of(page: sa.CTE) -> sa.Subquery:
    record = EffectiveRecord
    columns: list[Any] = []
    for name in HEADLINE_COLUMNS:
        amount = getattr(record, name)
        columns += [
            sa.func.sum(amount).label(name),
            coverage_of(amount, record.consumed_g).label(f"{name}_coverage"),
        ]
    return (
        sa.select(
            page.c.participant_id,
            page.c.local_date,
            sa.func.count(record.item_id).label("item_count"),
            sa.func.count(sa.case((record.consumed_g.is_(None), record.item_id))).label("unmeasured"),
            sa.func.sum(sa.case((record.provisional, 1), else_=0)).label("provisional"),
            sa.func.sum(sa.case((is_leftover_unknown(), 1), else_=0)).label("leftovers_unknown"),
            sa.func.sum(record.consumed_g).label("consumed_g"),
            *columns,
        )
        .select_from(page)
        .outerjoin(
            record,
            sa.and_(_same_day(record.participant_id, record.local_date, page), record.status != "rejected"),
        )
        .outerjoin(Meal, Meal.id == record.meal_id)
        .outerjoin(Study, Study.id == record.study_id)
        .group_by(page.c.participant_id, page.c.local_date)
        .subquery()
    )


def _same_day(participant_id: Any, local_date: Any, page: sa.CTE) -> sa.ColumnElement[bool]:
    return sa.and_(participant_id == page.c.participant_id, local_date == page.c.local_date)


def _day_row(row: sa.Row[*tuple[Any, ...]]) -> DayRow:
    values = row._mapping  # noqa: SLF001  # SQLAlchemy's own way to a row by name
    return DayRow(
        participant_id=values["participant_id"],
        participant_code=values["participant_code"],
        study_code=values["study_code"],
        profile=values["profile"],
        local_date=values["local_date"],
        status=values["status"],
        said_nothing=bool(values["said_nothing"]),
        version=values["version"],
        changed_at=values["changed_at"],
        is_by_reviewer=bool(values["by_reviewer"]),
        meals=values["meals"],
        meals_after_closing=int(values["meals_after_closing"]),
        unmeasured_meals=int(values["unmeasured_meals"]),
        median_upload_delay_seconds=values["median_seconds"],
        items=values["item_count"],
        unmeasured_items=int(values["unmeasured"]),
        provisional_items=int(values["provisional"]),
        leftovers_unknown_items=int(values["leftovers_unknown"]),
        consumed_g=values["consumed_g"],
        amounts={column: Amount(values[column], values[f"{column}_coverage"]) for column in HEADLINE_COLUMNS},
    )
