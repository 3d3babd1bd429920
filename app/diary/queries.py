"""SQL of days: one row per participant-day, with the diary entry and the sums of meals and records.

Pages are in the order of (local_date, participant id). Days whose sums are outdated are counted again.
"""

import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from datetime import date, datetime
from typing import Literal, NamedTuple

import sqlalchemy as sa
from sqlalchemy.orm import InstrumentedAttribute, Session

from app.db.statements import AnyQuery
from app.diary.day_definition import COLUMNS, counted_days, same_day, within
from app.diary.day_sum_queries import DaySelection, is_marked
from app.diary.models import DaySum
from app.http.row_filter import RowFilter
from app.meals.day_models import DayEvent, DayStatus, DiaryDay
from app.meals.meal_time import number_of
from app.meals.models import Meal
from app.meals.queries import first_days
from app.meals.record_models import HEADLINE_COLUMNS
from app.people.models import Participant, Study
from app.people.profiles import Profile
from app.records.page_queries import MOST_BRANCHES, all_studies, participants_of, studies_of

DayKey = tuple[date, uuid.UUID]  # local day, participant


class Amount(NamedTuple):
    """A day's sum of a component over the items for which it is known, and their share of the eaten grams.

    value: None if it is known for no item. coverage: 0 to 1; None if the grams of an item or of a whole meal are
    unknown.
    """

    value: float | None
    coverage: float | None


@dataclass(frozen=True, slots=True)
class DayRow:
    """A participant's day.

    study_day: 1 on the participant's first day; None if no first day is known. said_nothing: the diary entry says that
    nothing was eaten; it counts while the day has no meal. version: 0 without an entry. meals_after_closing: meals that
    arrived after the day was closed. unmeasured_meals: without a known food and not confirmed to be without one.
    unmeasured_items: eaten grams unknown. leftovers_unknown_items: counted as eaten up because no leftovers were
    recorded, in a study that expects an after-meal pair.
    """

    participant_id: uuid.UUID
    participant_code: str
    study_code: str
    profile: Profile | None
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
        """Who made the diary entry that is in effect; None without an entry."""
        if self.version == 0:
            return None
        return "reviewer" if self.is_by_reviewer else "participant"

    @property
    def ate_nothing(self) -> bool:
        """Whether the day was closed with "nothing eaten" and has no meal."""
        return self.status == "closed" and self.said_nothing and self.meals == 0

    @property
    def is_nothing(self) -> bool:
        """Whether the day is closed and nothing was eaten: by the entry, or each meal is confirmed to have no food."""
        is_empty = self.meals > 0 and self.items == 0 and self.unmeasured_meals == 0
        return self.ate_nothing or (self.status == "closed" and is_empty)

    @property
    def is_complete(self) -> bool:
        """Whether the day is closed and all eaten grams are known and final (no after-meal pair is pending)."""
        is_measured = self.items > 0 and self.unmeasured_items == 0 and self.unmeasured_meals == 0
        return self.is_nothing or (self.status == "closed" and is_measured and self.provisional_items == 0)

    def amount(self, column: str) -> Amount:
        """Return the amount of one of HEADLINE_COLUMNS; 0 if nothing was eaten."""
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
    """Return the last day that has a meal or a diary entry."""
    return max(edge_days(session, sa.func.max, lambda table: [table.participant_id == participant_id]), default=None)


def edge_days(
    session: Session, edge: Callable[[InstrumentedAttribute[date]], sa.ColumnElement[date]], selection: DaySelection
) -> list[date]:
    """Return the first or last day with a meal and with a diary entry. edge: sa.func.min or sa.func.max."""
    days = [session.scalar(sa.select(edge(table.local_date)).where(*selection(table))) for table in (Meal, DiaryDay)]
    return [day for day in days if day is not None]


def _page_keys(session: Session, chosen: RowFilter, after: DayKey | None, limit: int | None) -> AnyQuery | None:
    """Select the first days after `after`; None if the filter names a study or participant that does not exist.

    The days of each study, or participant, are read from an index that has this order.
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
            parts += [sa.select(*ordered.where(owner == owner_id).subquery().c) for owner_id in ids]
        else:
            is_of_all = people is None and studies is None
            parts.append(days if is_of_all else days.where(owner.in_(ids)))
    keys = sa.union(*parts).subquery()
    return sa.select(*keys.c).order_by(keys.c.local_date, keys.c.participant_id).limit(limit)


def _rows_of(session: Session, page: sa.CTE) -> list[DayRow]:
    """Read the days of a page of keys, in order."""
    is_stale = sa.or_(DaySum.participant_id.is_(None), is_marked(page.c))
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
    return [
        DayRow(
            study_day=number_of(row["local_date"], first_day_of.get(row["participant_id"])),
            leftovers_unknown_items=row["unseen_leftovers_items"] if row["expects_after_pair"] else 0,
            amounts={column: Amount(row[column], row[f"{column}_coverage"]) for column in HEADLINE_COLUMNS},
            **{name: row[name] for name in ROW_COLUMNS},
        )
        for row in rows
    ]
