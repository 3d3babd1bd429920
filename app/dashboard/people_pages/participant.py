"""One participant: diary by local day, intakes beside reference intakes, profile, withdrawal."""

from collections import defaultdict
from datetime import UTC, date, datetime, timedelta
from urllib.parse import quote

from fastapi import APIRouter
from starlette.responses import Response

from app.core.errors import ConflictError, InvalidInputError
from app.dashboard.forms import (
    EMPTY_FORM,
    Fields,
    FormState,
    form_values,
    read_form,
    refused,
    take_version,
    with_point,
)
from app.dashboard.page import CurrentPage, Page
from app.diary import day_summaries, diary
from app.diary.feedback import read_feedback
from app.diary.schemas import DayIn, SummaryOut
from app.diary.study_days import judge_day
from app.exports.lists.days_api import day_event_kind
from app.exports.lists.list_meals import list_meals, sums_of
from app.http.parameters import LastDay
from app.http.row_filter import RowFilter
from app.nutrition.components import HEADLINES
from app.people import devices, participants
from app.people.access.page_rules import STUDY_PAGES, study_address
from app.people.participants_api import change_of
from app.people.profiles import PROFILE_KEYS
from app.people.schemas import ParticipantPatch
from app.privacy.erase import Eraser
from app.privacy.withdraw import withdraw_participant

router = APIRouter(include_in_schema=False)

PATH = f"{STUDY_PAGES}/participants/{{participant}}"
WINDOW_DAYS = 14
MOST_MEALS = 500  # of a window: thirty-five a day
SWITCHES = ("is_pregnant", "is_lactating")


@router.get(PATH)
def get_participant(
    page: CurrentPage, study: str, participant: str, last: LastDay = None
) -> Response:
    """Two weeks of the diary, up to `last`; by default up to the last day with a meal or a text entry."""
    return _participant(page, study, participant, last)


@router.post(f"{PATH}/profile")
def post_profile(page: CurrentPage, study: str, participant: str, fields: Fields) -> Response:
    """Change the profile; emptied fields are removed."""
    values = form_values(fields)
    profile = {key: with_point(values[key]) for key in PROFILE_KEYS if values.get(key)}
    emptied = {key: None for key in PROFILE_KEYS if key not in profile}
    try:
        columns = {name: values.get(name, "") for name in participants.COLUMNS}
        body = read_form(ParticipantPatch, {"profile": profile, **columns})
        change = change_of(body, also=emptied, sets_all=True)
        participants.change_participant(page.database, page.caller, study, participant, change)
    except (InvalidInputError, ConflictError) as error:
        return _participant(page, study, participant, form=refused(error))
    return page.redirect(
        study_address(study, "participants", participant), "The profile was changed."
    )


@router.post(f"{PATH}/days/{{day}}")
def post_day(
    page: CurrentPage, study: str, participant: str, day: date, fields: Fields
) -> Response:
    """Set a day's status as a reviewer, if the day is unchanged since the page was opened."""
    values = form_values(fields)
    expected, last_shown = take_version(values), values.pop("to", "")
    body = read_form(DayIn, values)
    diary.set_day(
        page.database,
        page.caller,
        day,
        day_event_kind(body),
        expected=expected,
        participant_ref=diary.ParticipantRef(study, participant),
    )
    target = study_address(study, "participants", participant)
    window = f"?to={quote(last_shown)}" if last_shown else ""
    return page.redirect(f"{target}{window}#day-{day}", f"{day} is now {body.status}.")


@router.post(f"{PATH}/withdrawal")
def post_withdrawal(page: CurrentPage, study: str, participant: str, fields: Fields) -> Response:
    """Withdraw the participant; the staff member types the code to confirm."""
    typed = form_values(fields).get("code", "")
    if typed != participant:
        wrong = {
            "withdrawal": f"“{typed[:64]}” is not the code {participant}: nobody was withdrawn."
        }
        return _participant(page, study, participant, form=FormState(wrong=wrong, status=422))
    receipt = withdraw_participant(page.state.part(Eraser), page.caller, study, participant)
    notice = f"{participant} has left the study; its policy ({receipt.policy}) was carried out. Receipt: {receipt.id}."
    return page.redirect(study_address(study, "participants"), notice)


def _participant(
    page: Page,
    study: str,
    code: str,
    last: date | None = None,
    form: FormState = EMPTY_FORM,
) -> Response:
    person = participants.read_participant(page.database, study, code)
    feedback = _feedback(page, study, code, last)
    end = last or (feedback.date if feedback is not None else datetime.now(UTC).date())
    first = end - min(timedelta(days=WINDOW_DAYS - 1), end - date.min)
    caller = page.study_caller
    window = RowFilter(study_code=study, participant_code=code, first_day=first, last_day=end)
    days = day_summaries.list_day_summaries(
        page.database, caller, window, cursor=None, limit=WINDOW_DAYS
    ).rows
    meals = list_meals(page.database, caller, window, order="oldest", cursor=None, limit=MOST_MEALS)
    meals_by_day = defaultdict(list)
    for row in meals.rows:
        meals_by_day[row.meal.local_date].append((row, sums_of(row)))
    phones = devices.list_devices(page.database, study, code, cursor=None, limit=20)
    return page.render(
        "participant.html",
        form=form,
        person=person,
        profile=person.profile or {},
        switches=SWITCHES,
        days=[(day, judge_day(day)) for day in reversed(days)],
        meals_by_day=meals_by_day,
        first=first,
        last=end,
        window=WINDOW_DAYS,
        earlier=first - timedelta(days=1)
        if first > date.min + timedelta(days=WINDOW_DAYS)
        else None,
        later=end + timedelta(days=WINDOW_DAYS)
        if end < date.max - timedelta(days=WINDOW_DAYS)
        else None,
        feedback=feedback,
        headlines=HEADLINES,
        phones=phones.rows,
    )


def _feedback(page: Page, study: str, code: str, day: date | None) -> SummaryOut | None:
    """Return the feedback that the participant sees, or would see; None if there is no day yet."""
    try:
        return read_feedback(page.database, page.caller, day, diary.ParticipantRef(study, code))
    except InvalidInputError:
        return None
