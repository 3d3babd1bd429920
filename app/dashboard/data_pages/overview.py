"""A study at a glance: who takes part, what waits, days, energy, nutrients, places. Of `study_overview` alone."""

from collections.abc import Mapping
from dataclasses import asdict
from datetime import date
from typing import Annotated, Literal
from urllib.parse import urlencode

from fastapi import APIRouter, Query
from pydantic import BeforeValidator
from starlette.responses import Response

from app.core.errors import InvalidInputError
from app.dashboard.addresses import study_address
from app.dashboard.data_pages.headline import HEADLINES
from app.dashboard.data_pages.overview_charts import day_charts, nutrient_chart
from app.dashboard.page import CurrentPage
from app.diary import overview_api
from app.diary.overview_api import Part
from app.diary.overview_queries import CountedStatus
from app.diary.study_overview import (
    DEFAULT_DAYS,
    DayOfPerson,
    StudyOverview,
    study_overview,
    study_waiting,
)
from app.http.text_schemas import LocalDay
from app.meals.models import MealStatus
from app.people.access.page_rules import STUDY_PAGES

router = APIRouter(include_in_schema=False)

PRESETS = (("7", "7 days"), ("28", "28 days"), ("90", "90 days"), ("all", "All"))
DAYS = {"7": 7, "28": 28, "90": 90, "all": None}
USUAL = "28"
PLACES_LISTED = 200
MOVING: tuple[MealStatus, ...] = ("receiving", "queued", "processing")

# a form sends a field that says nothing as ""
Blank = BeforeValidator(lambda told: None if isinstance(told, str) and not told.strip() else told)
Preset = Annotated[Literal["7", "28", "90", "all"] | None, Blank]
FirstDay = Annotated[LocalDay | None, Query(alias="from"), Blank]
LastDay = Annotated[LocalDay | None, Query(alias="to"), Blank]
Component = Annotated[str, Query(max_length=64)]


@router.get(STUDY_PAGES)
def get_overview_page(
    page: CurrentPage,
    study: str,
    days: Preset = None,
    first: FirstDay = None,
    last: LastDay = None,
    component: Component = HEADLINES[0].column,
) -> Response:
    """The page, of the days from `from` to `to`; else of so many up to the last that anything is known of."""
    chosen = "" if first or last else days or USUAL
    wrong = ""
    at = next((n for n, each in enumerate(HEADLINES) if each.column == component), 0)
    column = HEADLINES[at].column
    try:
        found = _found(page, study, first, last, days, column)
    except InvalidInputError as error:
        found, wrong = _found(page, study, None, None, USUAL, column), error.message
    nutrient = next(each for each in found.nutrients if each.component == column)
    charts = day_charts(found.days) | {"nutrient": nutrient_chart(nutrient, HEADLINES[at])}
    window = {"from": found.first_day.isoformat(), "to": found.last_day.isoformat()}

    def file(part: Part, output: str = "csv") -> str:
        return f"{study_address(study, 'overview')}?{urlencode(window | {'format': output, 'part': part})}"

    return page.render(
        "overview.html",
        status=422 if wrong else 200,
        found=found,
        waiting=found.waiting,
        failures=found.failures,
        is_moving=_is_moving(found.waiting),
        chosen=chosen,
        presets=PRESETS,
        typed={"from": first, "to": last} if first or last else window,
        wrong=wrong,
        days=found.days,
        charts={name: asdict(chart) for name, chart in charts.items()},
        headlines=HEADLINES,
        headline=HEADLINES[at],
        nutrient=nutrient,
        listed=PLACES_LISTED,
        points=_points(found),
        persons=_persons(found),
        file=file,
    )


@router.get(f"{STUDY_PAGES}/overview")
def get_overview_file(
    page: CurrentPage,
    study: str,
    first: FirstDay = None,
    last: LastDay = None,
    output: Annotated[Literal["json", "csv", "ndjson"], Query(alias="format")] = "json",
    part: Part | None = None,
) -> Response:
    """The page's figures as the API has them, or a table of them as a file."""
    return overview_api.get_overview(study, page.state, page.caller, first, last, output, part)


@router.get(f"{STUDY_PAGES}/waiting")
def get_waiting(page: CurrentPage, study: str) -> Response:
    """What waits at this moment: the page asks for it again and again."""
    waiting, failures = study_waiting(page.state.database, page.caller, study)
    return page.render("overview_waiting.html", waiting=waiting, failures=failures, is_moving=_is_moving(waiting))


def _found(
    page: CurrentPage, study: str, first: date | None, last: date | None, days: str | None, column: str
) -> StudyOverview:
    length = DAYS[days or USUAL] if first is None and last is None else DEFAULT_DAYS
    return study_overview(
        page.state.database, page.caller, study, first_day=first, last_day=last, days=length, binned=column
    )


def _persons(found: StudyOverview) -> dict[str, dict[date, DayOfPerson]]:
    """Participant -> day -> what is known of it; those of whom nothing is known or expected are not there."""
    persons: dict[str, dict[date, DayOfPerson]] = {}
    for each in found.person_days:
        persons.setdefault(each.participant, {})[each.local_date] = each
    return persons


def _is_moving(waiting: Mapping[CountedStatus, int]) -> bool:
    return any(waiting[status] for status in MOVING)


def _points(found: StudyOverview) -> list[tuple[object, ...]]:
    """What the map takes: latitude, longitude, participant, local day, the meal's id."""
    return [(each.latitude, each.longitude, each.participant, each.local_date, each.meal_id) for each in found.places]
