"""The overview of a study: participation, waiting meals, days, energy, nutrients, places (`study_overview`)."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import date
from typing import Annotated, Literal
from urllib.parse import urlencode

from fastapi import APIRouter, Query
from starlette.responses import Response

from app.core.errors import InvalidInputError
from app.dashboard.forms import Blank
from app.dashboard.page import CurrentPage
from app.diary import api as diary_api
from app.diary.api import Part
from app.diary.distribution import Distribution
from app.diary.overview_schemas import CountedStatus, OverviewDayOut, PersonDayOut
from app.diary.study_overview import (
    DEFAULT_DAYS,
    StudyOverview,
    study_overview,
    study_waiting,
)
from app.http.flat_list import FlatFormat
from app.http.text_schemas import LocalDay
from app.meals.stored.models import MealStatus
from app.nutrition.components import HEADLINES, Headline
from app.people.access.page_rules import STUDY_PAGES, study_address

router = APIRouter(include_in_schema=False)

PRESETS = (("7", "7 days"), ("28", "28 days"), ("90", "90 days"), ("all", "All"))
DAYS = {"7": 7, "28": 28, "90": 90, "all": None}
DEFAULT_PRESET = "28"
PLACES_LISTED = 200
MOVING: tuple[MealStatus, ...] = ("receiving", "queued", "processing")

Preset = Annotated[Literal["7", "28", "90", "all"] | None, Blank]
FirstDay = Annotated[LocalDay | None, Query(alias="from"), Blank]
LastDay = Annotated[LocalDay | None, Query(alias="to"), Blank]
Component = Annotated[str, Query(max_length=64)]


@dataclass(frozen=True, slots=True)
class Series:
    """A series of values, None for gaps. counts: the number of days behind each value."""

    label: str
    values: Sequence[float | None]
    colour: str
    draw: str = "bars"
    fill: str = "solid"
    counts: Sequence[int] | None = None


@dataclass(frozen=True, slots=True)
class Mark:
    """A vertical line at a value of the x axis."""

    label: str
    at: float
    colour: str
    dash: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Chart:
    """A chart of days (labels) or of bins (edges).

    whole: no fractions on the y axis. low: of small height.
    """

    kind: str = "days"
    caption: str
    series: Sequence[Series]
    unit: str = ""
    labels: Sequence[str] = ()
    edges: Sequence[float] = ()
    x_unit: str = ""
    whole: bool = False
    stacked: bool = False
    low: bool = False
    marks: Sequence[Mark] = ()


def day_charts(days: Sequence[OverviewDayOut]) -> dict[str, Chart]:
    """Return name -> chart of the window's days."""
    labels = [day.local_date.isoformat() for day in days]
    late = [None if day.late_share is None else 100 * day.late_share for day in days]
    return {
        "meals": Chart(
            caption="Meals per day",
            labels=labels,
            series=[Series("Meals", [day.meals for day in days], "series-1")],
            whole=True,
        ),
        "completeness": Chart(
            caption="Participants per day: closed, open with a meal, no entry",
            labels=labels,
            series=[
                Series("Closed", [day.told_closed for day in days], "series-1"),
                Series(
                    "Open with a meal", [day.told_open for day in days], "series-1", fill="hatched"
                ),
                Series("No entry", [day.silent for day in days], "soft", fill="hollow"),
            ],
            whole=True,
            stacked=True,
        ),
        "late": Chart(
            caption="Share of meals that came late",
            unit="%",
            labels=labels,
            series=[Series("Late", late, "series-2")],
            low=True,
        ),
        "delay": Chart(
            caption="Median delay per day",
            unit="s",
            labels=labels,
            series=[
                Series(
                    "Median delay", [day.median_delay_seconds for day in days], "series-3", "line"
                )
            ],
            low=True,
        ),
        "energy": Chart(
            caption="Mean energy of a participant's day",
            unit="kcal",
            labels=labels,
            series=[
                Series(
                    "Whole days",
                    [day.whole_energy_kcal for day in days],
                    "series-1",
                    "line",
                    counts=[day.whole for day in days],
                ),
                Series(
                    "Open days, at least",
                    [day.open_energy_kcal for day in days],
                    "series-2",
                    "dashed",
                    counts=[day.open_days for day in days],
                ),
            ],
        ),
    }


def nutrient_chart(nutrient: Distribution, headline: Headline) -> Chart:
    """Return the distribution of a nutrient over whole days, with its mean and median."""
    marks = []
    if nutrient.mean is not None:
        marks.append(Mark("mean", nutrient.mean, "series-2", ()))
    if nutrient.median is not None:
        marks.append(Mark("median", nutrient.median, "series-3", (6, 4)))
    return Chart(
        kind="bins",
        caption=f"{headline.label} of whole days, {headline.unit}",
        edges=nutrient.edges,
        x_unit=headline.unit,
        series=[Series("Days", nutrient.counts, "series-1")],
        whole=True,
        marks=marks,
    )


@router.get(STUDY_PAGES)
def get_overview_page(
    page: CurrentPage,
    study: str,
    days: Preset = None,
    first: FirstDay = None,
    last: LastDay = None,
    component: Component = HEADLINES[0].column,
) -> Response:
    """The overview of the days from `from` to `to`, or of the last days with data."""
    wrong = ""
    headline = next(
        (headline for headline in HEADLINES if headline.column == component), HEADLINES[0]
    )
    try:
        overview = _overview(page, study, first, last, days, headline.column)
    except InvalidInputError as error:
        overview, wrong = (
            _overview(page, study, None, None, DEFAULT_PRESET, headline.column),
            error.message,
        )
    nutrient = next(
        nutrient for nutrient in overview.nutrients if nutrient.component == headline.column
    )
    charts = day_charts(overview.days) | {"nutrient": nutrient_chart(nutrient, headline)}
    window = {"from": overview.first_day.isoformat(), "to": overview.last_day.isoformat()}

    def file(part: Part, output: str = "csv") -> str:
        return f"{study_address(study, 'overview')}?{urlencode(window | {'format': output, 'part': part})}"

    return page.render(
        "overview.html",
        status=422 if wrong else 200,
        overview=overview,
        waiting=overview.waiting,
        failures=overview.failures,
        is_moving=_is_moving(overview.waiting),
        chosen="" if first or last else days or DEFAULT_PRESET,
        presets=PRESETS,
        entered={"from": first, "to": last} if first or last else window,
        wrong=wrong,
        days=overview.days,
        charts={name: asdict(chart) for name, chart in charts.items()},
        headlines=HEADLINES,
        headline=headline,
        nutrient=nutrient,
        listed=PLACES_LISTED,
        points=_map_points(overview),
        participant_days=_participant_days(overview),
        file=file,
    )


@router.get(f"{STUDY_PAGES}/overview")
def get_overview_file(
    page: CurrentPage,
    study: str,
    first: FirstDay = None,
    last: LastDay = None,
    output: Annotated[Literal["json", FlatFormat], Query(alias="format")] = "json",
    part: Part | None = None,
) -> Response:
    """The page's figures as the API returns them, or one of their tables as a file."""
    return diary_api.get_overview(study, page.state, page.caller, first, last, output, part)


@router.get(f"{STUDY_PAGES}/waiting")
def get_waiting(page: CurrentPage, study: str) -> Response:
    """The waiting meals; the page polls them."""
    waiting, failures = study_waiting(page.database, page.caller, study)
    return page.render(
        "overview_waiting.html", waiting=waiting, failures=failures, is_moving=_is_moving(waiting)
    )


def _overview(
    page: CurrentPage,
    study: str,
    first: date | None,
    last: date | None,
    days: str | None,
    column: str,
) -> StudyOverview:
    length = DAYS[days or DEFAULT_PRESET] if first is None and last is None else DEFAULT_DAYS
    return study_overview(
        page.database,
        page.caller,
        study,
        first_day=first,
        last_day=last,
        days=length,
        binned=column,
    )


def _participant_days(overview: StudyOverview) -> dict[str, dict[date, PersonDayOut]]:
    """Return participant -> local day -> summary, without days that have no data and expect none."""
    by_participant: dict[str, dict[date, PersonDayOut]] = {}
    for day in overview.person_days:
        by_participant.setdefault(day.participant, {})[day.local_date] = day
    return by_participant


def _is_moving(waiting: Mapping[CountedStatus, int]) -> bool:
    return any(waiting[status] for status in MOVING)


def _map_points(overview: StudyOverview) -> list[tuple[object, ...]]:
    """Return (latitude, longitude, participant, local day, meal id) for each point of the map."""
    return [
        (place.latitude, place.longitude, place.participant, place.local_date, place.meal_id)
        for place in overview.places
    ]
