"""A study's participants, by code; what each ate on average; and a new one, or many."""

import re
from collections.abc import Mapping, Sequence
from datetime import date
from types import MappingProxyType
from typing import Annotated

from fastapi import APIRouter, Query
from starlette.responses import Response

from app.core.errors import ConflictError
from app.dashboard.addresses import study_address
from app.dashboard.data_pages.headline import HEADLINES
from app.dashboard.forms import Fields, checked, typed
from app.dashboard.page import CurrentPage, Page
from app.diary import day_summaries
from app.diary.adequacy import Adequacy, find_component, judge_study
from app.http.paging import Cursor, require_order
from app.http.parameters import FirstDay, LastDay
from app.people import participants
from app.people.access.page_rules import STUDY_PAGES
from app.people.access.secret_box import SecretBox
from app.people.schemas import ParticipantIn

router = APIRouter(include_in_schema=False)

PARTICIPANTS_A_PAGE = 100
NOBODY: Mapping[str, Sequence[str]] = MappingProxyType({})
MOST_AT_ONCE = 500
USUAL_COMPONENT = "vitamin_c_mg"
LONGEST_CODE = 64
SHOWN = 80  # letters of what is no code
_BETWEEN_CODES = re.compile(r"[\r\n\t,;]+")  # no blanks: "Anna Müller" would become two participants

ComponentIn = Annotated[str, Query(max_length=64)]


@router.get(f"{STUDY_PAGES}/participants")
def get_participants(page: CurrentPage, study: str, cursor: Cursor = None) -> Response:
    """The list, those who have left too."""
    return _participants(page, study, cursor)


@router.post(f"{STUDY_PAGES}/participants")
def post_participants(page: CurrentPage, study: str, fields: Fields) -> Response:
    """Add participants by their codes, one or many. If one is no code, none is added; those that are taken are told."""
    asked = typed(fields).get("codes", "")
    codes = list(dict.fromkeys(code for code in map(str.strip, _BETWEEN_CODES.split(asked)) if code))
    if not codes or len(codes) > MOST_AT_ONCE:
        wrong = [f"Name one to {MOST_AT_ONCE} participants; these are {len(codes)}."]
        return _participants(page, study, None, asked=asked, wrong=wrong, status=422)
    wrong = [_refusal(code) for code in codes if checked(ParticipantIn, {"code": code})[0] is None]
    if wrong:
        return _participants(page, study, None, asked=asked, wrong=wrong, status=422)
    refused: dict[str, list[str]] = {"participant_exists": [], "participant_code_spent": []}
    for code in codes:
        try:
            participants.create_participant(
                page.state.database, page.state.part(SecretBox), study_code=study, code=code, caller=page.caller
            )
        except ConflictError as error:
            refused[error.code].append(code)
    added = len(codes) - sum(map(len, refused.values()))
    told = f"{added} participant{'s were' if added != 1 else ' was'} added."
    if any(refused.values()):
        return _participants(page, study, None, refused=refused, added=told, status=409)
    return page.go(study_address(study, "participants"), told)


@router.get(f"{STUDY_PAGES}/intakes")
def get_intakes(
    page: CurrentPage, study: str, first: FirstDay = None, last: LastDay = None, cursor: Cursor = None
) -> Response:
    """Each participant's mean daily intake over closed days, and on how many days it rests."""
    found = day_summaries.list_intakes(
        page.state.database,
        page.caller,
        study,
        first_day=first,
        last_day=last,
        cursor=cursor,
        limit=PARTICIPANTS_A_PAGE,
    )
    return page.render("intakes.html", rows=found.rows, next=found.cursor, first=first, last=last, headlines=HEADLINES)


@router.get(f"{STUDY_PAGES}/adequacy")
def get_adequacy(
    page: CurrentPage,
    component: ComponentIn = USUAL_COMPONENT,
    first: FirstDay = None,
    last: LastDay = None,
) -> Response:
    """What can be asked; the page then asks for the figures, which take a moment in a large study."""
    return _adequacy(page, None, component, first, last)


@router.get(f"{STUDY_PAGES}/adequacy/figures")
def get_adequacy_figures(
    page: CurrentPage,
    study: str,
    component: ComponentIn = USUAL_COMPONENT,
    first: FirstDay = None,
    last: LastDay = None,
) -> Response:
    """The share of each group whose usual intake of a component lies below the EAR; by itself a whole page."""
    require_order(first, last)
    judged = judge_study(page.state.database, page.caller, study, component, first_day=first, last_day=last)
    if page.is_fragment:
        return page.render("adequacy_figures.html", judged=judged)
    return _adequacy(page, judged, component, first, last)


def _adequacy(page: Page, judged: Adequacy | None, component: str, first: date | None, last: date | None) -> Response:
    require_order(first, last)
    choices = [(each.column, each.name) for each in HEADLINES]
    return page.render(
        "adequacy.html",
        judged=judged,
        asked=find_component(component),
        component=component,
        choices=choices,
        first=first,
        last=last,
    )


def _refusal(code: str) -> str:
    """What is wrong with a code, in a sentence for who typed it."""
    if len(code) > LONGEST_CODE:
        return f"{code[:SHOWN]}{'…' if len(code) > SHOWN else ''}: {LONGEST_CODE} characters at most"
    blank = "; no blanks: one code a line, or commas between" if re.search(r"\s", code) else ""
    return f"{code}: letters A-Z, digits, - and _ only, beginning with a letter or digit{blank}"


def _participants(
    page: Page,
    study: str,
    cursor: str | None,
    *,
    asked: str = "",
    wrong: Sequence[str] = (),
    refused: Mapping[str, Sequence[str]] = NOBODY,
    added: str = "",
    status: int = 200,
) -> Response:
    """The page. asked: stays in the field; wrong: why nobody was added; refused: an error's code -> whom it kept."""
    found = participants.list_participants(page.state.database, study, cursor=cursor, limit=PARTICIPANTS_A_PAGE)
    return page.render(
        "participants.html",
        status=status,
        rows=found.rows,
        next=found.cursor,
        asked=asked,
        wrong=wrong,
        there=refused.get("participant_exists", ()),
        spent=refused.get("participant_code_spent", ()),
        added=added,
    )
