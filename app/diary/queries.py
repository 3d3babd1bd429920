"""SQL of days: what meals and records come to, a row a participant-day.

What a day comes to is defined in day_definition.py and kept in DaySum; a day that has changed since (DayMark) is
counted when it is asked for, so that what is told is of the moment of the question. Days page by (local_date,
participant id).
"""

import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date, datetime
from typing import Any, Literal, NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import Session

from app.db.statements import AnyQuery
from app.diary.day_definition import COLUMNS, counted_days
from app.diary.models import DayEvent, DayMark, DaySum, DiaryDay
from app.http.row_filter import RowFilter
from app.meals.models import Meal
from app.meals.record_models import HEADLINE_COLUMNS
from app.people.models import Participant, Study
from app.records.page_queries import MOST_BRANCHES, all_studies, participants_of, studies_of

DayStatus = Literal["open", "closed"]
DayKey = tuple[date, uuid.UUID]  # local day, participant


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


def page_of_days(session: Session, chosen: RowFilter, *, after: DayKey | None, limit: int) -> list[DayRow]:
    """At most `limit` participant-days that have a meal or a word, in the order of (day, participant id)."""
    found = _page_keys(session, chosen, after, limit)
    if found is None:
        return []
    return _rows_of(session, found.cte("page"))


def _page_keys(session: Session, chosen: RowFilter, after: DayKey | None, limit: int) -> AnyQuery | None:
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


def _first(keys: sa.Subquery, limit: int) -> AnyQuery:
    chosen = sa.select(keys.c.participant_id, keys.c.local_date)
    return chosen.order_by(keys.c.local_date, keys.c.participant_id).limit(limit)


def _within(query: AnyQuery, table: type[Meal | DiaryDay], chosen: RowFilter, after: DayKey | None) -> AnyQuery:
    """The days of a range, behind a key."""
    if chosen.first_day is not None:
        query = query.where(table.local_date >= chosen.first_day)
    if chosen.last_day is not None:
        query = query.where(table.local_date <= chosen.last_day)
    if after is not None:
        key = sa.tuple_(sa.literal(after[0], sa.Date()), sa.literal(after[1], sa.Uuid()))
        query = query.where(sa.tuple_(table.local_date, table.participant_id) > key)
    return query


def days_of(session: Session, chosen: RowFilter) -> list[DayRow]:
    """All days of the filter: for one participant, or a range that is bounded."""
    return _rows_of(session, keys_of(chosen, None).cte("page"))


def find_day(session: Session, participant_id: uuid.UUID, local_date: date) -> DayRow | None:
    """One participant-day; None where nothing is known of it."""
    chosen = RowFilter(participant_id=participant_id, first_day=local_date, last_day=local_date)
    return next(iter(days_of(session, chosen)), None)


def keys_of(chosen: RowFilter, after: DayKey | None) -> AnyQuery:
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


def filtered(query: AnyQuery, study_id: Any, participant_id: Any, local_date: Any, chosen: RowFilter) -> AnyQuery:
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


def sums_of_days(session: Session, which: Callable[[type[DaySum | DayMark]], Sequence[Any]]) -> sa.Subquery:
    """What each of these days comes to, COLUMNS of DaySum; those that have changed since are counted anew.

    which: the conditions on a table's participant_id, local_date and study_id.
    """
    kept = sa.select(*(DaySum.__table__.c[name] for name in COLUMNS)).where(*which(DaySum))
    if not session.scalar(sa.select(sa.exists().where(*which(DayMark)))):
        return kept.subquery("day")
    keys = sa.select(DayMark.participant_id, DayMark.local_date).where(*which(DayMark)).distinct()
    return sa.union_all(kept.where(~_is_marked(DaySum)), counted_days(keys.cte("marked"))).subquery("day")


def _rows_of(session: Session, page: sa.CTE) -> list[DayRow]:
    """The days of a page of keys, in their order."""
    by_reviewer = sa.exists().where(_same_day(DayEvent, page.c), DayEvent.layer == "reviewer")
    query = (
        sa.select(
            Participant.code.label("participant_code"),
            Study.code.label("study_code"),
            Participant.profile,
            Study.expects_after_pair,
            sa.func.coalesce(DiaryDay.version, 0).label("version"),
            DiaryDay.changed_at,
            by_reviewer.label("is_by_reviewer"),
            sa.or_(DaySum.participant_id.is_(None), _is_marked(page.c)).label("is_stale"),
            page.c.participant_id,
            page.c.local_date,
            *(DaySum.__table__.c[name] for name in COLUMNS if name not in ("participant_id", "local_date")),
        )
        .select_from(page)
        .join(Participant, Participant.id == page.c.participant_id)
        .join(Study, Study.id == Participant.study_id)
        .outerjoin(DiaryDay, _same_day(DiaryDay, page.c))
        .outerjoin(DaySum, _same_day(DaySum, page.c))
        .order_by(page.c.local_date, page.c.participant_id)
    )
    rows = session.execute(query).mappings().all()
    counted: dict[DayKey, sa.RowMapping] = {}
    if any(row["is_stale"] for row in rows):
        is_stale = sa.or_(DaySum.participant_id.is_(None), _is_marked(page.c))
        stale = (
            sa.select(page.c.participant_id, page.c.local_date)
            .outerjoin(DaySum, _same_day(DaySum, page.c))
            .where(is_stale)
            .cte("stale")
        )
        anew = session.execute(counted_days(stale)).mappings()
        counted = {(each["local_date"], each["participant_id"]): each for each in anew}
    return [_day_row(row, counted.get((row["local_date"], row["participant_id"]), row)) for row in rows]


def _is_marked(of: Any) -> sa.ColumnElement[bool]:
    """Whether a day has changed since its sums were written."""
    return sa.exists().where(_same_day(DayMark, of))


def _same_day(table: Any, of: Any) -> sa.ColumnElement[bool]:
    return sa.and_(table.participant_id == of.participant_id, table.local_date == of.local_date)


def _day_row(row: sa.RowMapping, sums: sa.RowMapping) -> DayRow:
    return DayRow(
        participant_id=sums["participant_id"],
        participant_code=row["participant_code"],
        study_code=row["study_code"],
        profile=row["profile"],
        local_date=sums["local_date"],
        status=sums["status"],
        said_nothing=bool(sums["said_nothing"]),
        version=row["version"],
        changed_at=row["changed_at"],
        is_by_reviewer=bool(row["is_by_reviewer"]),
        meals=sums["meals"],
        meals_after_closing=sums["meals_after_closing"],
        unmeasured_meals=sums["unmeasured_meals"],
        median_upload_delay_seconds=sums["median_upload_delay_seconds"],
        items=sums["items"],
        unmeasured_items=sums["unmeasured_items"],
        provisional_items=sums["provisional_items"],
        leftovers_unknown_items=sums["unseen_leftovers_items"] if row["expects_after_pair"] else 0,
        consumed_g=sums["consumed_g"],
        amounts={column: Amount(sums[column], sums[f"{column}_coverage"]) for column in HEADLINE_COLUMNS},
    )
