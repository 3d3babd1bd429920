"""A study's meals as a gallery of photographs or as a table: the rows of `GET /v1/meals` by the same filters.

Filters, view and order are in the address. Meals that are being measured are polled together every few seconds and
replaced in place. The same rows, their items and their photographs are offered as files.
"""

import uuid
from typing import Annotated, Literal, get_args

from fastapi import APIRouter, Query
from pydantic import StringConstraints
from starlette.responses import Response

from app.core.errors import InvalidInputError
from app.dashboard.addresses import study_address
from app.dashboard.meal_pages.flag_words import FLAGS
from app.dashboard.meal_pages.meal_filters import Filters, MealFilters, View
from app.dashboard.meal_pages.meal_list_views import FAILURES, ListedMeal, element_of, listed_meal
from app.dashboard.page import CurrentPage, Page
from app.exports.export_files import answer_file
from app.exports.export_spec import ExportSpec, formats_of
from app.exports.lists.list_meals import (
    MOST_WATCHED,
    changed_meals,
    count_meals,
    list_doubtful_meals,
    list_meals,
    missing_meals,
)
from app.foods.foods import food_names
from app.http.file_formats import FORMATS, Output
from app.http.paging import Cursor
from app.meals.stored.models import AfterStatus, MealStatus
from app.people.access.page_rules import PREFIX

router = APIRouter(include_in_schema=False)

MEALS = PREFIX + "/studies/{study}/meals"
MEALS_A_PAGE = {"gallery": 24, "table": 100}
FileRows = Literal["meals", "items", "photographs"]
FILE_PARAMETERS = {
    "order": None,
    "view": None,
    "cursor": None,
}  # removed from the address of a file

# PARTICIPANT:ID:VERSION as it is shown
Watched = Annotated[
    str,
    StringConstraints(max_length=120, pattern=r"^[0-9A-Za-z_-]+:[0-9A-Fa-f-]{32,36}:[0-9]{1,9}$"),
]


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
    database = page.state.database
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

    A meal that never existed, or that the caller may not see, is removed too: the answers do not differ.
    """
    database, study_id = page.state.database, page.require_study().id
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
    database, filters = page.state.database, chosen.filters
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
