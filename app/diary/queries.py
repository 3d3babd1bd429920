"""SQL of the diary: days as lists have them, by (local day, participant id), diary entries, the meals of a day."""

import uuid
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, fields
from datetime import date, datetime
from typing import Literal

import sqlalchemy as sa
from sqlalchemy.orm import InstrumentedAttribute, Session

from app.db.statements import AnyQuery
from app.diary.day_definition import (
    CountedDay,
    DayKey,
    DaysOf,
    count_days,
    count_where,
    delay_seconds,
    delays_text,
    group_by_day,
    median_or_none,
    unseen_leftovers,
    within,
)
from app.http.row_filter import RowFilter
from app.meals.stored.event_models import DayEvent, DiaryDay
from app.meals.stored.meal_time import number_of
from app.meals.stored.models import Meal
from app.meals.stored.queries import first_days
from app.meals.stored.record_models import EffectiveRecord
from app.people.models import Participant, Study
from app.people.profiles import Profile
from app.records.page_queries import MOST_BRANCHES, all_studies, participants_of, studies_of

Conditions = Sequence[sa.ColumnElement[bool]]
COUNTED = tuple(field.name for field in fields(CountedDay))
DaySelection = Callable[[type[Meal | DiaryDay]], Conditions]


@dataclass(frozen=True, slots=True)
class DayRow(CountedDay):
    """A participant's day.

    study_day: 1 on the participant's first day; None if no first day is known version, changed_at:
    of the diary entry; 0 and None without one meals_after_closing: meals that arrived after the day
    was closed median_upload_delay_seconds: from eating to arrival, of the day's meals
    leftovers_unknown_items: counted as eaten up because no leftovers were recorded, in a study that
    expects an after-meal pair
    """

    participant_code: str
    study_code: str
    profile: Profile | None
    study_day: int | None
    version: int
    changed_at: datetime | None
    is_by_reviewer: bool
    meals_after_closing: int
    median_upload_delay_seconds: float | None
    leftovers_unknown_items: int

    @property
    def decided_by(self) -> Literal["participant", "reviewer"] | None:
        """Who made the diary entry that is in effect; None without an entry."""
        if self.version == 0:
            return None
        return "reviewer" if self.is_by_reviewer else "participant"

    @property
    def consumed_g(self) -> float | None:
        """The eaten grams of the items for which they are known; 0 if nothing was eaten."""
        return 0.0 if self.is_nothing else self.eaten_g


def page_of_days(
    session: Session, chosen: RowFilter, *, after: DayKey | None = None, limit: int | None = None
) -> list[DayRow]:
    """Return participant-days that have a meal or a diary entry, in the order of (day, participant id)."""
    query = _page_keys(session, chosen, after, limit)
    if query is None:
        return []
    keys = {(local_date, participant_id) for participant_id, local_date in session.execute(query)}
    if not keys:
        return []
    people = {participant_id for _, participant_id in keys}
    days = [local_date for local_date, _ in keys]
    rows = read_days(session, DaysOf(people, min(days), max(days)))
    return [row for row in rows if (row.local_date, row.participant_id) in keys]


def read_days(session: Session, days: DaysOf) -> list[DayRow]:
    """Return the days that have a meal or a diary entry, in the order of (day, participant id)."""
    counted = count_days(session, days)
    people_query = sa.select(Participant, Study).join(Study, Study.id == Participant.study_id)
    people_query = people_query.where(Participant.id.in_(days.participants))
    people = {
        participant.id: (participant, study) for participant, study in session.execute(people_query)
    }
    expects_leftovers = any(study.expects_after_pair for _, study in people.values())
    leftovers = unseen_leftovers(session, days) if expects_leftovers else {}
    reviewed = _reviewed_days(session, days)
    entries = _entries(session, days)
    arrivals = _arrivals(session, days)
    first_day_of = first_days(session, people.keys())
    rows = []
    for day in counted:
        key = (day.local_date, day.participant_id)
        participant, study = people[day.participant_id]
        version, changed_at = entries.get(key, (0, None))
        after_closing, delays = arrivals.get(key, (0, ""))
        row = DayRow(
            **{name: getattr(day, name) for name in COUNTED},
            participant_code=participant.code,
            study_code=study.code,
            profile=participant.profile,
            study_day=number_of(day.local_date, first_day_of.get(day.participant_id)),
            version=version,
            changed_at=changed_at,
            is_by_reviewer=key in reviewed,
            meals_after_closing=after_closing,
            median_upload_delay_seconds=median_or_none(delay_seconds(delays)),
            leftovers_unknown_items=leftovers.get(key, 0) if study.expects_after_pair else 0,
        )
        rows.append(row)
    return rows


def _entries(session: Session, days: DaysOf) -> dict[DayKey, tuple[int, datetime]]:
    """Return the diary entries' version and time."""
    entry = DiaryDay
    query = sa.select(entry.local_date, entry.participant_id, entry.version, entry.changed_at)
    return {
        (row[0], row[1]): (row[2], row[3])
        for row in session.execute(query.where(*days.rows(entry)))
    }


def _reviewed_days(session: Session, days: DaysOf) -> set[DayKey]:
    """Return the days about which a reviewer has made an entry."""
    query = sa.select(DayEvent.local_date, DayEvent.participant_id)
    rows = session.execute(query.where(DayEvent.layer == "reviewer", *days.rows(DayEvent)))
    return {(row[0], row[1]) for row in rows}


def _arrivals(session: Session, days: DaysOf) -> dict[DayKey, tuple[int, str]]:
    """Return the number of meals that arrived after the day was closed, and all meals' delays as a text."""
    is_entry = sa.and_(
        DiaryDay.participant_id == Meal.participant_id, DiaryDay.local_date == Meal.local_date
    )
    is_after_closing = sa.and_(DiaryDay.status == "closed", Meal.received_at > DiaryDay.changed_at)
    query = sa.select(
        Meal.local_date, Meal.participant_id, count_where(is_after_closing), delays_text()
    )
    rows = session.execute(group_by_day(query.outerjoin(DiaryDay, is_entry), days, Meal))
    return {(row[0], row[1]): (row[2], row[3]) for row in rows}


def find_day(session: Session, participant_id: uuid.UUID, local_date: date) -> DayRow | None:
    """Return a participant-day; None where it has neither a meal nor a diary entry."""
    chosen = RowFilter(participant_id=participant_id, first_day=local_date, last_day=local_date)
    return next(iter(page_of_days(session, chosen)), None)


def latest_day_of(session: Session, participant_id: uuid.UUID) -> date | None:
    """Return the last day that has a meal or a diary entry."""
    return max(
        edge_days(session, sa.func.max, lambda table: [table.participant_id == participant_id]),
        default=None,
    )


def edge_days(
    session: Session,
    edge: Callable[[InstrumentedAttribute[date]], sa.ColumnElement[date]],
    selection: DaySelection,
) -> list[date]:
    """Return the first or last day with a meal and with a diary entry.

    edge: sa.func.min or sa.func.max.
    """
    days = [
        session.scalar(sa.select(edge(table.local_date)).where(*selection(table)))
        for table in (Meal, DiaryDay)
    ]
    return [day for day in days if day is not None]


def _page_keys(
    session: Session, chosen: RowFilter, after: DayKey | None, limit: int | None
) -> AnyQuery | None:
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


def events_of(
    session: Session, participant_id: uuid.UUID, days: Collection[date]
) -> list[DayEvent]:
    """Return a participant's day events on these days, the oldest first."""
    query = (
        sa.select(DayEvent)
        .where(DayEvent.participant_id == participant_id, DayEvent.local_date.in_(days))
        .order_by(DayEvent.created_at, DayEvent.id)
    )
    return list(session.scalars(query))


def count_meals(session: Session, participant_id: uuid.UUID, local_date: date) -> int:
    """Count a participant's meals on a day."""
    query = (
        sa.select(sa.func.count())
        .select_from(Meal)
        .where(Meal.participant_id == participant_id, Meal.local_date == local_date)
    )
    return session.execute(query).scalar_one()


def meals_of_day(
    session: Session, participant_id: uuid.UUID, local_date: date
) -> list[tuple[Meal, list[EffectiveRecord]]]:
    """Return the day's meals in order, each with its records that are not rejected."""
    query = sa.select(Meal).where(
        Meal.participant_id == participant_id, Meal.local_date == local_date
    )
    meals = session.scalars(query.order_by(Meal.captured_at, Meal.id)).all()
    records = sa.select(EffectiveRecord).where(
        EffectiveRecord.meal_id.in_([meal.id for meal in meals]),
        EffectiveRecord.status != "rejected",
    )
    by_meal: dict[uuid.UUID, list[EffectiveRecord]] = {meal.id: [] for meal in meals}
    for record in session.scalars(records.order_by(EffectiveRecord.item_id)):
        by_meal[record.meal_id].append(record)
    return [(meal, by_meal[meal.id]) for meal in meals]


def lock_participant(session: Session, participant_id: uuid.UUID) -> Participant | None:
    """Lock a participant until commit, so that their day events are written one by one.

    None: erased meanwhile.
    """
    query = sa.select(Participant).where(Participant.id == participant_id)
    query = query.with_for_update(key_share=True)  # does not block new meals
    return session.scalars(query.execution_options(populate_existing=True)).one_or_none()
