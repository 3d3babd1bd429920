"""A study's meals as a gallery of photographs or as a table: the rows of `GET /v1/meals` by the same filters.

Filters, view and order are in the address. Meals that are being measured are polled together every
few seconds and replaced in place. The same rows, their items and their photographs are offered as
files.
"""

import uuid
from dataclasses import dataclass
from datetime import UTC
from typing import Annotated, Literal, TypeVar, get_args
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from fastapi import APIRouter, Depends, Query
from pydantic import BeforeValidator, StringConstraints
from starlette.responses import Response

from app.core.errors import InvalidInputError
from app.dashboard.forms import Blank
from app.dashboard.meal_pages.flag_words import FLAGS
from app.dashboard.page import CurrentPage, Page
from app.exports.export_files import MOST_VALUES, Code, FoodKey, answer_file, meal_filter
from app.exports.export_spec import FILTERS, ExportSpec, Rows, formats_of
from app.exports.lists.list_meals import (
    MOST_WATCHED,
    MealSums,
    changed_meals,
    count_meals,
    list_doubtful_meals,
    list_meals,
    missing_meals,
    sums_of,
)
from app.exports.lists.meal_row_queries import MealRow
from app.foods.foods import food_names
from app.http.file_formats import FORMATS, Output
from app.http.paging import Cursor, reversed_range_message
from app.http.row_filter import RowFilter
from app.http.text_schemas import LocalDay
from app.meals.stored.item_state import REMEASURING
from app.meals.stored.models import AfterStatus, MealStatus
from app.meals.stored.queries import UNESTIMATED
from app.people.access.page_rules import PREFIX, study_address

Origin = Literal["photographed", "declared"]
Needs = Literal["review", "answer"]
Order = Literal["newest", "oldest", "doubt"]
View = Literal["gallery", "table"]
# why a meal failed: the codes of docs/errors.md, "Meals that cannot be measured"
FAILURES = (
    *("image_too_small", "image_too_dark", "image_blurred"),
    *("marker_not_found", "marker_covered", "marker_mismatch"),
    *("camera_mismatch", "same_photograph"),
    *("baseline_too_small", "baseline_too_large", "focal_unknown"),
    *("pose_unreliable", "too_few_matches", "scene_moved"),
    *("table_not_found", "rig_mismatch", "depth_unreadable", "depth_mismatch", "depth_empty"),
    *("draw_unusable", "food_not_measured", "no_food_found"),
    *("photo_damaged", "photograph_missing"),
    *("estimate_crashed", "estimate_timed_out", "estimate_killed"),
    *("estimate_out_of_memory", "cancelled", "job_gave_up"),
)
FOODS_NAMED = 6  # in a photograph's description
router = APIRouter(include_in_schema=False)

MEALS = PREFIX + "/studies/{study}/meals"
MEALS_A_PAGE = {"gallery": 24, "table": 100}
FileRows = Literal["meals", "items", "photographs"]
# removed from the address of a file
FILE_PARAMETERS = {"order": None, "view": None, "cursor": None}

# PARTICIPANT:ID:VERSION as it is shown
Watched = Annotated[
    str,
    StringConstraints(max_length=120, pattern=r"^[0-9A-Za-z_-]+:[0-9A-Fa-f-]{32,36}:[0-9]{1,9}$"),
]


def _without_blanks(values: object) -> object:
    return [value for value in values if str(value).strip()] if isinstance(values, list) else values


Value = TypeVar("Value")
Blanks = BeforeValidator(_without_blanks)
# below the form's first row
MORE = ("statuses", "flags", "origin", "needs", "failure_codes", "after_statuses")


@dataclass(frozen=True, slots=True)
class MealFilters:
    """The validated filters, order and view."""

    study: str
    filters: RowFilter
    order: Order
    view: View

    @property
    def is_any(self) -> bool:
        """Whether any filter is set."""
        return len(self.filters.set_names) > 1

    @property
    def more(self) -> int:
        """How many filters are set that the form hides at first."""
        return len([name for name in self.filters.set_names if name in MORE])

    @property
    def wrong_days(self) -> str | None:
        """A sentence if the first day is after the last."""
        return reversed_range_message(self.filters.first_day, self.filters.last_day)

    def reaches(self, rows: Rows) -> bool:
        """Whether a file of these rows supports all filters that are set.

        An item's status is not the meal's.
        """
        names = set(self.filters.set_names)
        return names <= set(FILTERS[rows]) and (rows != "items" or "statuses" not in names)


def meal_filters(
    study: str,
    participant: Annotated[str | None, Query(max_length=64), Blank] = None,
    first_day: Annotated[LocalDay | None, Query(alias="from"), Blank] = None,
    last_day: Annotated[LocalDay | None, Query(alias="to"), Blank] = None,
    status: Annotated[list[MealStatus] | None, Query(max_length=7), Blanks] = None,
    origin: Annotated[Origin | None, Query(), Blank] = None,
    failure: Annotated[list[Code] | None, Query(max_length=MOST_VALUES), Blanks] = None,
    after_status: Annotated[list[AfterStatus] | None, Query(max_length=7), Blanks] = None,
    food: Annotated[list[FoodKey] | None, Query(max_length=MOST_VALUES), Blanks] = None,
    flag: Annotated[list[Code] | None, Query(max_length=MOST_VALUES), Blanks] = None,
    needs: Annotated[Needs | None, Query(), Blank] = None,
    order: Annotated[Order | None, Query(), Blank] = None,
    view: View = "gallery",
) -> MealFilters:
    """Read the address's parameters, which FastAPI validates."""
    code = participant.strip() if participant is not None else None
    filters = meal_filter(
        RowFilter(study, code, first_day, last_day),
        status=_each_once(status),
        origin=origin,
        failure=_each_once(failure),
        after_status=_each_once(after_status),
        food=_each_once(food),
        flag=_each_once(flag),
        needs=needs,
    )
    return MealFilters(study, filters, order or "newest", view)


Filters = Annotated[MealFilters, Depends(meal_filters)]


def _each_once(values: list[Value] | None) -> list[Value]:
    return list(dict.fromkeys(values or ()))


@dataclass(frozen=True, slots=True)
class ListedMeal:
    """A meal and the sums of its records."""

    row: MealRow
    sums: MealSums

    @property
    def key(self) -> tuple[str, uuid.UUID]:
        """The meal's key in its study."""
        return self.row.participant_code, self.row.meal.client_id

    @property
    def element(self) -> str:
        """The id of its HTML element."""
        return element_of(*self.key)

    @property
    def watched(self) -> str:
        """Key and shown version, by which the page polls for a newer version."""
        return f"{self.row.participant_code}:{self.row.meal.client_id}:{self.row.meal.version}"

    @property
    def is_moving(self) -> bool:
        """Whether the meal, its after-meal pair or an item waits for a worker or for photographs."""
        meal = self.row.meal
        return (
            meal.status in UNESTIMATED
            or meal.after_status in UNESTIMATED
            or any(REMEASURING in record.flags for record in self.row.records)
        )

    @property
    def delay_seconds(self) -> float:
        """Time from eating to the arrival of the first part."""
        return (self.row.meal.received_at - self.row.meal.captured_at).total_seconds()

    @property
    def foods(self) -> str:
        """Names of the foods; "" if nothing is known."""
        names = [food.name for food in self.sums.foods]
        unknown = sum(record.food_key is None for record in self.row.records)
        if unknown:
            names.append("an unknown food" if unknown == 1 else f"{unknown} unknown foods")
        if names:
            more = len(names) - FOODS_NAMED
            return "; ".join(names[:FOODS_NAMED]) + (f"; {more} more" if more > 0 else "")
        return "nothing" if self.row.meal.status == "confirmed" else ""

    @property
    def description(self) -> str:
        """The photograph's alternative text."""
        return f"Meal of {self.row.participant_code}, {self.when}: {self.foods or 'its foods are unknown'}"

    @property
    def when(self) -> str:
        """When the meal was eaten, in its time zone."""
        meal = self.row.meal
        try:
            zone = ZoneInfo(meal.time_zone)
        except (ZoneInfoNotFoundError, ValueError):
            return f"{meal.captured_at.astimezone(UTC):%Y-%m-%d %H:%M}"
        return f"{meal.captured_at.astimezone(zone):%Y-%m-%d %H:%M}"


def element_of(participant: str, client_id: uuid.UUID) -> str:
    """Return the id of a meal's HTML element."""
    return f"meal-{participant}-{client_id}"


def listed_meal(row: MealRow) -> ListedMeal:
    """Return the row with its sums."""
    return ListedMeal(row, sums_of(row))


@router.get(MEALS)
def get_meals(
    page: CurrentPage,
    chosen: Filters,
    cursor: Cursor = None,
    rows: FileRows = "meals",
    output: Annotated[Output | None, Query(alias="format")] = None,
) -> Response:
    """The page; with `format` all matching rows as a file, the oldest first."""
    caller = page.study_caller
    if output is not None:
        if not chosen.reaches(rows):
            raise InvalidInputError(
                f"A file of {rows} does not have all of these filters.", code="export_not_offered"
            )
        return answer_file(
            page.state, caller, ExportSpec(rows, output=output, filters=chosen.filters)
        )
    database = page.database
    if chosen.wrong_days is not None:
        return _render(page, chosen, [], next_cursor=None, status=422)
    limit = MEALS_A_PAGE[chosen.view]
    if chosen.order == "doubt":
        doubtful = list_doubtful_meals(database, caller, chosen.filters, limit)
        return _render(page, chosen, [listed_meal(row) for row in doubtful], next_cursor=None)
    meals = list_meals(
        database, caller, chosen.filters, order=chosen.order, cursor=cursor, limit=limit
    )
    return _render(page, chosen, [listed_meal(row) for row in meals.rows], next_cursor=meals.cursor)


@router.get(PREFIX + "/studies/{study}/changed-meals")
def get_changed(
    page: CurrentPage,
    study: str,
    meal: Annotated[list[Watched] | None, Query(max_length=MOST_WATCHED)] = None,
    view: View = "gallery",
) -> Response:
    """Those of the watched meals that have changed, each for its place in the page, and those to remove from it.

    A meal that never existed, or that the caller may not see, is removed too: the answers do not
    differ.
    """
    database, study_id = page.database, page.require_study().id
    versions = dict(map(_parse_watched, meal or ()))
    rows = changed_meals(
        database, study_id, [(client_id, version) for (_, client_id), version in versions.items()]
    )
    changed = {meal.key: meal for meal in map(listed_meal, rows) if meal.key in versions}
    gone = missing_meals(database, study_id, [key for key in versions if key not in changed])
    if not changed and not gone:
        return Response(status_code=204)
    watched = [
        f"{participant}:{client_id}:{version}"
        for (participant, client_id), version in versions.items()
        if (participant, client_id) not in changed and (participant, client_id) not in gone
    ]
    watched += [meal.watched for meal in changed.values() if meal.is_moving]
    return page.render(
        "meals_changed.html",
        changed=list(changed.values()),
        ended=[meal for meal in changed.values() if not meal.is_moving],
        gone=[(participant, element_of(participant, client_id)) for participant, client_id in gone],
        watch=watch_address(study, view, watched),
        view=view,
    )


def watch_address(study: str, view: View, watched: list[str]) -> str | None:
    """Return the address that the page polls for these meals; None without any."""
    if not watched:
        return None
    return f"{study_address(study, 'changed-meals')}?view={view}" + "".join(
        f"&meal={meal}" for meal in watched[:MOST_WATCHED]
    )


def _render(
    page: Page,
    chosen: MealFilters,
    meals: list[ListedMeal],
    *,
    next_cursor: str | None,
    status: int = 200,
) -> Response:
    database, filters = page.database, chosen.filters
    counts, needs_look = count_meals(database, page.require_study().id)
    return page.render(
        "meals.html",
        status=status,
        chosen=chosen,
        filters=filters,
        meals=meals,
        next=next_cursor,
        counts=[count for count in counts if count.status != "needs_review"],
        needs_look=needs_look,
        watch=watch_address(
            chosen.study, chosen.view, [meal.watched for meal in meals if meal.is_moving]
        ),
        view=chosen.view,
        food_names=food_names(database, filters.food_keys),
        statuses=get_args(MealStatus),
        after_statuses=get_args(AfterStatus),
        all_flags=FLAGS,
        all_failures=FAILURES,
        files=[
            (
                rows,
                [
                    (
                        FORMATS[output].title,
                        page.address(**FILE_PARAMETERS, rows=rows, format=output),
                    )
                    for output in formats_of(rows)
                ],
            )
            for rows in get_args(FileRows)
            if chosen.reaches(rows) and chosen.wrong_days is None
        ],
    )


def _parse_watched(watched: str) -> tuple[tuple[str, uuid.UUID], int]:
    """Return the meal's key and its version as it is shown."""
    participant, client_id, version = watched.split(":")
    return (participant, uuid.UUID(client_id)), int(version)
