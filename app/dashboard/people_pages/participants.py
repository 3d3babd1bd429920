"""A study's participants: who is behind, closing their days, adding some; mean intakes, adequacy by group."""

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from types import MappingProxyType
from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import ValidationError
from starlette.responses import Response

from app.core.errors import ConflictError, InvalidInputError, PreconditionFailedError
from app.dashboard.forms import Fields, form_values
from app.dashboard.page import CurrentPage, Page
from app.dashboard.people_pages.devices import MOST_CARDS
from app.diary import api as diary_api
from app.diary import day_summaries
from app.diary.adequacy import find_component, judge_study
from app.diary.api import LeastDays
from app.diary.diary import ParticipantRef, set_day
from app.diary.progress import study_flow, study_progress
from app.diary.progress_schemas import ProgressFilter, ProgressFilterIn
from app.diary.schemas import AdequacyOut
from app.exports.lists import days_api
from app.http.flat_list import ListRoute
from app.http.paging import Cursor, require_order
from app.http.parameters import FirstDay, LastDay
from app.nutrition.components import HEADLINES
from app.nutrition.intakes.compare_intake import MIN_DAYS
from app.people import participants
from app.people.access.page_rules import STUDY_PAGES, study_address
from app.people.access.secret_box import SecretBox
from app.people.schemas import ParticipantIn

router = APIRouter(include_in_schema=False, route_class=ListRoute)

PARTICIPANTS_A_PAGE = 100
ENDED_AFTER = timedelta(days=2)  # a study's day that starts at noon, in the westernmost zone
EVERYBODY = ProgressFilter()
NO_CODES: Mapping[str, Sequence[str]] = MappingProxyType({})
MOST_AT_ONCE = 500
USUAL_COMPONENT = "vitamin_c_mg"
LONGEST_CODE = 64
SHOWN = 80  # characters of an invalid code in its message
# no blanks: "Anna Müller" would become two participants
_BETWEEN_CODES = re.compile(r"[\r\n\t,;]+")
_RANGE = re.compile(
    r"(?P<stem>[A-Za-z]\w*?)(?P<first>\d{1,9}) ?[-–] ?(?P=stem)(?P<last>\d{1,9})", re.ASCII
)

ComponentIn = Annotated[str, Query(max_length=64)]

# the API's lists as files
router.add_api_route(f"{STUDY_PAGES}/files/progress", diary_api.get_progress, methods=["GET"])
router.add_api_route(f"{STUDY_PAGES}/files/flow", diary_api.get_flow, methods=["GET"])
router.add_api_route(f"{STUDY_PAGES}/files/intakes", days_api.get_intakes, methods=["GET"])
router.add_api_route(f"{STUDY_PAGES}/files/adequacy", diary_api.get_adequacy, methods=["GET"])


@router.get(f"{STUDY_PAGES}/participants")
def get_participants(
    page: CurrentPage,
    study: str,
    chosen: ProgressFilterIn,
    cursor: Annotated[int, Query(ge=0)] = 0,
) -> Response:
    """How far the participants are, including those who have left. cursor: rows to pass over."""
    return _participants(page, study, chosen, cursor=cursor)


@router.post(f"{STUDY_PAGES}/closed-days")
def post_closed_days(
    page: CurrentPage, study: str, chosen: ProgressFilterIn, fields: Fields
) -> Response:
    """Close the participants' open days that have ended everywhere and that nobody has closed or reopened."""
    codes = [str(code) for code in fields.getlist("participant")]
    if not codes:
        raise InvalidInputError("Mark one participant at least.")
    marked = replace(chosen, participants=codes)
    progress = study_progress(page.database, page.caller, study, marked)
    ended = datetime.now(UTC).date() - ENDED_AFTER
    open_days = [(row, day) for row in progress.items for day in row.open_days if day <= ended]
    closed = 0
    for row, day in open_days:
        with suppress(PreconditionFailedError, ConflictError):
            person = ParticipantRef(study, row.code)
            version = frozenset({0})  # nobody has closed or reopened it
            set_day(
                page.database, page.caller, day, "closed", expected=version, participant_ref=person
            )
            closed += 1
    query = page.request.url.query
    return page.redirect(
        f"{study_address(study, 'participants')}?{query}",
        f"Open days that were closed: {closed}.",
    )


@router.post(f"{STUDY_PAGES}/participants")
def post_participants(page: CurrentPage, study: str, fields: Fields) -> Response:
    """Add participants by their codes and ranges.

    An invalid code adds nobody; codes that are taken are listed.
    """
    entered = form_values(fields).get("codes", "")
    codes = list(
        dict.fromkeys(
            code for text in _BETWEEN_CODES.split(entered) for code in _codes_of(text.strip())
        )
    )
    if not codes or len(codes) > MOST_AT_ONCE:
        wrong = [f"Name one to {MOST_AT_ONCE} participants; these are {len(codes)}."]
    else:
        wrong = [_wrong_code(code) for code in codes if not _is_code(code)]
    if wrong:
        return _participants(page, study, entered=entered, wrong=wrong, status=422)
    refused: dict[str, list[str]] = {"participant_exists": [], "participant_code_spent": []}
    for code in codes:
        try:
            participants.create_participant(
                page.database,
                page.state.part(SecretBox),
                study_code=study,
                code=code,
                caller=page.caller,
            )
        except ConflictError as error:
            refused[error.code].append(code)
    taken = {code for codes_of_error in refused.values() for code in codes_of_error}
    added = [code for code in codes if code not in taken]
    return _participants(page, study, refused=refused, added=added, status=409 if taken else 201)


@router.get(f"{STUDY_PAGES}/flow")
def get_flow(page: CurrentPage, study: str, least_days: LeastDays = MIN_DAYS) -> Response:
    """The study's flow, from registered to analysed participants."""
    flow = study_flow(page.database, page.caller, study, least_days)
    return page.render("flow.html", rows=flow.items, least_days=least_days)


@router.get(f"{STUDY_PAGES}/intakes")
def get_intakes(
    page: CurrentPage,
    study: str,
    first: FirstDay = None,
    last: LastDay = None,
    cursor: Cursor = None,
) -> Response:
    """Each participant's mean daily intake over closed days, with the number of days."""
    intakes = day_summaries.list_intakes(
        page.database,
        page.caller,
        study,
        first_day=first,
        last_day=last,
        cursor=cursor,
        limit=PARTICIPANTS_A_PAGE,
    )
    return page.render(
        "intakes.html",
        rows=intakes.rows,
        next=intakes.cursor,
        first=first,
        last=last,
        headlines=HEADLINES,
    )


@router.get(f"{STUDY_PAGES}/adequacy")
def get_adequacy(
    page: CurrentPage,
    component: ComponentIn = USUAL_COMPONENT,
    first: FirstDay = None,
    last: LastDay = None,
) -> Response:
    """The form; the page then requests the figures, which take a moment in a large study."""
    return _adequacy(page, None, component, first, last)


@router.get(f"{STUDY_PAGES}/adequacy/figures")
def get_adequacy_figures(
    page: CurrentPage,
    study: str,
    component: ComponentIn = USUAL_COMPONENT,
    first: FirstDay = None,
    last: LastDay = None,
) -> Response:
    """Each group's share with a usual intake below the EAR: a fragment for htmx, otherwise the whole page."""
    require_order(first, last)
    judged = judge_study(
        page.database, page.caller, study, component, first_day=first, last_day=last
    )
    if page.is_fragment:
        return page.render("adequacy_figures.html", judged=judged)
    return _adequacy(page, judged, component, first, last)


def _adequacy(
    page: Page, judged: AdequacyOut | None, component: str, first: date | None, last: date | None
) -> Response:
    require_order(first, last)
    return page.render(
        "adequacy.html",
        judged=judged,
        chosen=find_component(component),
        component=component,
        choices=[(headline.column, headline.label) for headline in HEADLINES],
        first=first,
        last=last,
    )


def _codes_of(text: str) -> list[str]:
    """Return the codes of a range such as T001-T020 or T1-T20; any other text is one code, blank text none."""
    ends = _RANGE.fullmatch(text)
    if ends is None:
        return [text] if text else []
    first, last = sorted((int(ends["first"]), int(ends["last"])))
    width = min(len(ends["first"]), len(ends["last"]))
    return [
        f"{ends['stem']}{number:0{width}}"
        for number in range(first, min(last, first + MOST_AT_ONCE) + 1)
    ]


def _is_code(code: str) -> bool:
    try:
        ParticipantIn(code=code)
    except ValidationError:
        return False
    return True


def _wrong_code(code: str) -> str:
    """Return what is wrong with a code, for the person who entered it."""
    if len(code) > LONGEST_CODE:
        return (
            f"{code[:SHOWN]}{'…' if len(code) > SHOWN else ''}: {LONGEST_CODE} characters at most"
        )
    blank = "; no blanks: one code per line, or commas between" if re.search(r"\s", code) else ""
    return f"{code}: letters A-Z, digits, - and _ only, beginning with a letter or digit{blank}"


def _participants(
    page: Page,
    study: str,
    chosen: ProgressFilter = EVERYBODY,
    *,
    cursor: int = 0,
    entered: str = "",
    wrong: Sequence[str] = (),
    refused: Mapping[str, Sequence[str]] = NO_CODES,
    added: Sequence[str] | None = None,
    status: int = 200,
) -> Response:
    """entered: stays in the field; wrong: why nobody was added; refused: error code -> participants."""
    progress = study_progress(page.database, page.caller, study, chosen)
    behind = cursor + PARTICIPANTS_A_PAGE
    return page.render(
        "participants.html",
        status=status,
        rows=progress.items[cursor:behind],
        next=behind if behind < len(progress.items) else None,
        progress=progress,
        chosen=chosen,
        entered=entered,
        wrong=wrong,
        existing=refused.get("participant_exists", ()),
        spent=refused.get("participant_code_spent", ()),
        added=added,
        cards_a_sheet=MOST_CARDS,
    )
