"""How far the participants of a study are: who is behind, and the study's flow as CONSORT asks for it.

Days are those of the overview's window. Last entries, questions, meals and phones are of now.
"""

from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, date, datetime, timedelta
from statistics import fmean

from sqlalchemy.orm import Session

from app.db.session import Database
from app.diary.day_definition import CountedDay
from app.diary.diary import day_range
from app.diary.overview_queries import Window, first_day_of
from app.diary.progress_queries import participants_now
from app.diary.progress_schemas import (
    FlowOut,
    FlowRowOut,
    Order,
    ProgressFilter,
    ProgressOut,
    ProgressRowOut,
    Stage,
)
from app.diary.schemas import PlausibilityOut
from app.diary.study_days import judge_days
from app.diary.study_overview import DEFAULT_DAYS, expected_span
from app.meals.stored.meal_time import latest_day
from app.people.access.caller import Caller
from app.people.models import Study
from app.people.privacy_queries import count_erased_participants
from app.people.profiles import Profile
from app.people.schemas import ParticipantRow
from app.people.studies import enter_study

NEVER = datetime(1970, 1, 1, tzinfo=UTC)
# the smaller, the further behind
PLACES: Mapping[Order, Callable[[ProgressRowOut], date | float]] = {
    "last_entry": lambda row: row.last_entry or date.min,
    "complete": lambda row: row.complete_days / row.expected_days if row.expected_days else 1.0,
    "questions": lambda row: -row.open_questions,
    "unmeasured": lambda row: -(row.failed_meals + row.waiting_meals),
    "seen": lambda row: row.phone_seen_at or NEVER,
    "energy": lambda row: row.plausibility.verdict not in ("low", "high"),
}


def study_progress(
    database: Database, caller: Caller, study_code: str, chosen: ProgressFilter
) -> ProgressOut:
    """Return how far the participants are.

    Raises NotFoundError, InvalidInputError (`days_reversed`, `days_too_many`).
    """
    yesterday = datetime.now(UTC).date() - timedelta(days=1)
    first, last = day_range(chosen.first_day, chosen.last_day, yesterday, DEFAULT_DAYS)
    with database.read() as session:
        study = enter_study(session, caller, study_code)
        rows = progress_rows(session, study, first, last)
    rows = [
        row
        for row in rows
        if (not chosen.participants or row.code in chosen.participants)
        and chosen.arm in ("", row.arm)
        and chosen.visit in ("", row.visit)
    ]
    if chosen.order != "participant":
        place, share = PLACES[chosen.order], PLACES["complete"]
        rows.sort(key=lambda row: (not row.is_in, place(row), share(row)))
    return ProgressOut(first_day=first, last_day=last, items=rows)


def progress_rows(session: Session, study: Study, first: date, last: date) -> list[ProgressRowOut]:
    """Return all participants of a study by code. first, last: the window, both included."""
    window = Window(session, study.id, first, last)
    counted = window.days()
    persons = {person.id: person for person in window.persons(counted)}
    days_of = defaultdict(list)
    for day in counted:
        days_of[day.participant_id].append(day)
    today = latest_day(datetime.now(UTC))
    rows = []
    for now in participants_now(session, study.id):
        days = days_of[now.id]
        begin, end = expected_span(persons[now.id], first, last, today)
        rows.append(
            ProgressRowOut(
                **ParticipantRow.model_validate(now, from_attributes=True).model_dump(),
                enrolled_at=now.enrolled_at,
                last_entry=max(filter(None, (now.last_meal, now.last_closed)), default=None),
                expected_days=max(0, (end - begin).days + 1),
                complete_days=sum(
                    day.is_complete for day in days if begin <= day.local_date <= end
                ),
                open_days=[day.local_date for day in days if day.meals and not day.is_closed],
                open_questions=now.open_questions or 0,
                failed_meals=now.failed_meals or 0,
                waiting_meals=now.waiting_meals or 0,
                phone_seen_at=now.phone_seen_at,
                plausibility=_energy(now.profile, days, last),
            )
        )
    return rows


def _energy(profile: Profile | None, days: Sequence[CountedDay], last: date) -> PlausibilityOut:
    amounts = [day.whole_amount("energy_kcal") for day in days]
    whole = [amount for amount in amounts if amount is not None]
    judged = judge_days(
        profile,
        days[-1].local_date if days else last,
        fmean(whole) if whole else None,
        len(whole),
    )
    return PlausibilityOut.model_validate(judged, from_attributes=True)


def study_flow(database: Database, caller: Caller, study_code: str, least_days: int) -> FlowOut:
    """Count a study's participants by stage, arm and reason; each stands in one row, also the erased ones.

    least_days: complete days with which a participant is analysed. Raises NotFoundError.
    """
    today = latest_day(datetime.now(UTC))
    with database.read() as session:
        study = enter_study(session, caller, study_code)
        first = first_day_of(session, study.id) or today
        rows = progress_rows(session, study, first, today)
        erased = count_erased_participants(session, study.id)
    counts = Counter((*_stage(row, least_days), row.arm) for row in rows)
    if erased:
        counts["withdrawn", None, None] += erased
    return FlowOut(
        items=[
            FlowRowOut(stage=stage, reason=reason, arm=arm, participants=number)
            for (stage, reason, arm), number in sorted(counts.items(), key=str)
        ]
    )


def _stage(row: ProgressRowOut, least_days: int) -> tuple[Stage, str | None]:
    """Return the first stage that holds, and the reason for an exclusion."""
    if row.enrolled_at is None:
        return "not_enrolled", row.excluded
    if row.withdrawn_at is not None:
        return "withdrawn", None
    if row.excluded is not None:
        return "excluded", row.excluded
    return "analysed" if row.complete_days >= least_days else "too_few_days", None
