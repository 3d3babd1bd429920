"""SQL of days: what meals and records come to, a row a participant-day.

What a day comes to is defined in day_definition.py and kept in DaySum; a day that has changed since (DayMark) is
counted when it is asked for, so that what is told is of the moment of the question. Days page by (local_date,
participant id).
"""

import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import date, datetime
from typing import Any, Literal, NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import InstrumentedAttribute, Session

from app.db.statements import AnyQuery
from app.diary.day_definition import COLUMNS, DayKeys, counted_days, same_day, within
from app.diary.models import DayMark, DaySum
from app.http.row_filter import RowFilter
from app.meals.day_models import DayEvent, DayStatus, DiaryDay
from app.meals.meal_time import number_of
from app.meals.models import Meal
from app.meals.queries import first_days
from app.meals.record_models import HEADLINE_COLUMNS
from app.people.models import Participant, Study
from app.records.page_queries import MOST_BRANCHES, all_studies, participants_of, studies_of

DayKey = tuple[date, uuid.UUID]  # local day, participant
Conditions = Sequence[sa.ColumnElement[bool]]
DayTable = type[DaySum | DayMark | Meal | DiaryDay]
Which = Callable[[DayTable], Conditions]  # of the days in a table, by its participant_id, local_date and study_id


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

    study_day: its number, 1 on the participant's first day; None where no first day is known. said_nothing: the diary
    entry that nothing was eaten; it counts while there is no meal. version: 0 without an entry.
    meals_after_closing: meals that came in after the day was closed. unmeasured_meals: of which no food is known, and
    nobody has said that there was none. unmeasured_items: whose eaten grams are not known. leftovers_unknown_items:
    those that count as eaten up since nobody has looked, where the study expects an after-meal pair.
    """

    participant_id: uuid.UUID
    participant_code: str
    study_code: str
    profile: dict[str, Any] | None
    local_date: date
    study_day: int | None
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
    def decided_by(self) -> Literal["participant", "reviewer"] | None:
        """Whose diary entry holds; None: there is none."""
        if self.version == 0:
            return None
        return "reviewer" if self.is_by_reviewer else "participant"

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


ROW_COLUMNS = tuple(
    field.name for field in fields(DayRow) if field.name not in ("study_day", "leftovers_unknown_items", "amounts")
)


def page_of_days(
    session: Session, chosen: RowFilter, *, after: DayKey | None = None, limit: int | None = None
) -> list[DayRow]:
    """Return participant-days that have a meal or a diary entry, in the order of (day, participant id)."""
    keys = _page_keys(session, chosen, after, limit)
    return _rows_of(session, keys.cte("page")) if keys is not None else []


def find_day(session: Session, participant_id: uuid.UUID, local_date: date) -> DayRow | None:
    """Return a participant-day; None where it has neither a meal nor a diary entry."""
    chosen = RowFilter(participant_id=participant_id, first_day=local_date, last_day=local_date)
    return next(iter(page_of_days(session, chosen)), None)


def latest_day_of(session: Session, participant_id: uuid.UUID) -> date | None:
    """The last day that has a meal or a diary entry."""
    return max(edge_days(session, sa.func.max, lambda table: [table.participant_id == participant_id]), default=None)


def of_study(study_id: uuid.UUID, first_day: date | None, last_day: date | None) -> Which:
    """The days of a study in a range, both ends included."""
    return lambda table: [table.study_id == study_id, *within(table.local_date, first_day, last_day)]


def edge_days(
    session: Session, edge: Callable[[InstrumentedAttribute[date]], sa.ColumnElement[date]], which: Which
) -> list[date]:
    """The least, or greatest, of these days that has a meal, and that has a diary entry. edge: sa.func.min or max."""
    days = [session.scalar(sa.select(edge(table.local_date)).where(*which(table))) for table in (Meal, DiaryDay)]
    return [day for day in days if day is not None]


def sums_of_days(session: Session, which: Which) -> sa.Subquery:
    """What each of these days comes to, COLUMNS of DaySum; days that have changed since are counted anew."""
    kept = sa.select(*(DaySum.__table__.c[name] for name in COLUMNS)).where(*which(DaySum))
    if not session.scalar(sa.select(sa.exists().where(*which(DayMark)))):
        return kept.subquery("day")
    keys = sa.select(DayMark.participant_id, DayMark.local_date).where(*which(DayMark)).distinct()
    return sa.union_all(kept.where(~_is_marked(DaySum)), counted_days(keys.cte("marked"))).subquery("day")


def _page_keys(session: Session, chosen: RowFilter, after: DayKey | None, limit: int | None) -> AnyQuery | None:
    """The first days behind `after`: those of each study, or participant, from an index that has them in this order.

    None: the filter names a study or a participant that is not there.
    """
    studies = studies_of(session, chosen.study_code, chosen.study_ids)
    people = participants_of(session, chosen.participant_code, chosen.participant_id, studies)
    ids = people if people is not None else studies if studies is not None else all_studies(session)
    if not ids:
        return None
    parts = []
    for table in (Meal, DiaryDay):
        owner = table.study_id if people is None else table.participant_id
        days = sa.select(table.participant_id, table.local_date)
        days = days.where(*within(table.local_date, chosen.first_day, chosen.last_day))
        if after is not None:
            key = sa.tuple_(sa.literal(after[0], sa.Date()), sa.literal(after[1], sa.Uuid()))
            days = days.where(sa.tuple_(table.local_date, table.participant_id) > key)
        if len(ids) <= MOST_BRANCHES // 2:
            ordered = days.distinct().order_by(table.local_date, table.participant_id).limit(limit)
            parts += [sa.select(*ordered.where(owner == each).subquery().c) for each in ids]
        else:
            is_of_all = people is None and studies is None
            parts.append(days if is_of_all else days.where(owner.in_(ids)))
    keys = sa.union(*parts).subquery()
    return sa.select(*keys.c).order_by(keys.c.local_date, keys.c.participant_id).limit(limit)


def _rows_of(session: Session, page: sa.CTE) -> list[DayRow]:
    """The days of a page of keys, in their order."""
    is_stale = sa.or_(DaySum.participant_id.is_(None), _is_marked(page.c))
    query = (
        sa.select(
            Participant.code.label("participant_code"),
            Study.code.label("study_code"),
            Participant.profile,
            Study.expects_after_pair,
            sa.func.coalesce(DiaryDay.version, 0).label("version"),
            DiaryDay.changed_at,
            sa.exists().where(same_day(DayEvent, page.c), DayEvent.layer == "reviewer").label("is_by_reviewer"),
            is_stale.label("is_stale"),
            *page.c,
            *(DaySum.__table__.c[name] for name in COLUMNS if name not in page.c),
        )
        .select_from(page)
        .join(Participant, Participant.id == page.c.participant_id)
        .join(Study, Study.id == Participant.study_id)
        .outerjoin(DiaryDay, same_day(DiaryDay, page.c))
        .outerjoin(DaySum, same_day(DaySum, page.c))
        .order_by(page.c.local_date, page.c.participant_id)
    )
    rows = [dict(row) for row in session.execute(query).mappings()]
    if any(row["is_stale"] for row in rows):
        stale = sa.select(*page.c).outerjoin(DaySum, same_day(DaySum, page.c)).where(is_stale).cte("stale")
        counted = {
            (row["participant_id"], row["local_date"]): row for row in session.execute(counted_days(stale)).mappings()
        }
        rows = [{**row, **counted.get((row["participant_id"], row["local_date"]), {})} for row in rows]
    first_day_of = first_days(session, {row["participant_id"] for row in rows})
    return [_day_row(row, first_day_of.get(row["participant_id"])) for row in rows]


def _day_row(row: Mapping[str, Any], first_day: date | None) -> DayRow:
    return DayRow(
        study_day=number_of(row["local_date"], first_day),
        leftovers_unknown_items=row["unseen_leftovers_items"] if row["expects_after_pair"] else 0,
        amounts={column: Amount(row[column], row[f"{column}_coverage"]) for column in HEADLINE_COLUMNS},
        **{name: row[name] for name in ROW_COLUMNS},
    )


def _is_marked(day: DayKeys) -> sa.ColumnElement[bool]:
    """Whether a day has changed since its sums were written."""
    return sa.exists().where(same_day(DayMark, day))
