"""A study's meals, as a gallery of photographs or as a table: the rows of `GET /v1/meals` by the same filters.

Filters, view and order stand in the address. What is under way is asked for all together, every few seconds, and
shown in its place. The same rows, their items and their photographs leave as files.
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
from app.dashboard.meal_pages.meal_list_views import FAILURES, ListedMeal, element_of, listed
from app.dashboard.one_study import in_study
from app.dashboard.page import CurrentPage, Page
from app.exports.export_files import answer_file
from app.exports.export_spec import ExportSpec, Rows
from app.exports.lists.list_meals import MOST_WATCHED, changed_meals, count_meals, list_meals, missing_meals
from app.foods.foods import food_names
from app.http.paging import Cursor
from app.http.tables.media_types import Output
from app.meals.models import AfterStatus, MealStatus
from app.people.access.page_rules import PREFIX

router = APIRouter(include_in_schema=False)

MEALS = PREFIX + "/studies/{study}/meals"
MEALS_A_PAGE = {"gallery": 24, "table": 100}
FILES: dict[Rows, tuple[Output, ...]] = {
    "meals": ("csv", "ndjson", "parquet", "geojson"),
    "items": ("csv", "ndjson", "parquet", "geojson"),
    "photographs": ("csv", "ndjson", "parquet"),
}
NAMES: dict[Output, str] = {"csv": "CSV", "ndjson": "NDJSON", "parquet": "Parquet", "geojson": "GeoJSON"}
FILE_PARAMETERS = {"order": None, "view": None, "cursor": None}  # that a file has not

# PARTICIPANT:ID:VERSION as it is shown
Watched = Annotated[str, StringConstraints(max_length=120, pattern=r"^[0-9A-Za-z_-]+:[0-9A-Fa-f-]{32,36}:[0-9]{1,9}$")]


@router.get(MEALS)
def get_meals(
    page: CurrentPage,
    chosen: Filters,
    cursor: Cursor = None,
    rows: Literal["meals", "items", "photographs"] = "meals",
    output: Annotated[Output | None, Query(alias="format")] = None,
) -> Response:
    """The page; with `format` all that the filters leave as a file, the oldest first."""
    caller = in_study(page)
    if output is not None:
        if not chosen.reaches(rows):
            raise InvalidInputError(f"A file of {rows} has not all of these filters.", code="export_not_offered")
        return answer_file(page.state, caller, ExportSpec(rows, output=output, filters=chosen.filters), rows)
    database = page.state.database
    if chosen.told_reversed is not None:
        return _render(page, chosen, [], next_cursor=None, status=422)
    found = list_meals(
        database, caller, chosen.filters, order=chosen.order, cursor=cursor, limit=MEALS_A_PAGE[chosen.view]
    )
    return _render(page, chosen, [listed(row) for row in found.rows], next_cursor=found.cursor)


@router.get(PREFIX + "/studies/{study}/changed-meals")
def get_changed(
    page: CurrentPage,
    study: str,
    meal: Annotated[list[Watched] | None, Query(max_length=MOST_WATCHED)] = None,
    view: View = "gallery",
) -> Response:
    """Of the meals that a page shows and that are under way those that have changed, each to be put in its place.

    Those that are not there any more are to be taken away. One that never was, or that the caller may not see, is told
    in the same way.
    """
    caller = in_study(page)
    database, study_id = page.state.database, caller.only_study_id or uuid.UUID(int=0)
    known = {(participant, uuid.UUID(client_id)): int(version) for participant, client_id, version in _parts(meal)}
    rows = changed_meals(database, study_id, [(key[1], each) for key, each in known.items()])
    changed = {each.key: each for each in map(listed, rows) if each.key in known}
    gone = missing_meals(database, study_id, [key for key in known if key not in changed])
    if not changed and not gone:
        return Response(status_code=204)
    watched = [
        f"{participant}:{client_id}:{version}"
        for (participant, client_id), version in known.items()
        if (participant, client_id) not in changed and (participant, client_id) not in gone
    ]
    watched += [each.watched for each in changed.values() if each.is_moving]
    return page.render(
        "meals_changed.html",
        changed=list(changed.values()),
        ended=[each for each in changed.values() if not each.is_moving],
        gone=[(participant, element_of(participant, client_id)) for participant, client_id in gone],
        watch=watch_address(study, view, watched),
        view=view,
    )


def watch_address(study: str, view: View, watched: list[str]) -> str | None:
    """Where to ask what has become of these; None: of none."""
    if not watched:
        return None
    return f"{study_address(study, 'changed-meals')}?view={view}" + "".join(
        f"&meal={one}" for one in watched[:MOST_WATCHED]
    )


def _render(
    page: Page, chosen: MealFilters, meals: list[ListedMeal], *, next_cursor: str | None, status: int = 200
) -> Response:
    database, filters = page.state.database, chosen.filters
    return page.render(
        "meals.html",
        status=status,
        chosen=chosen,
        filters=filters,
        meals=meals,
        next=next_cursor,
        counts=count_meals(database, page.study.id) if page.study is not None else [],
        watch=watch_address(chosen.study, chosen.view, [each.watched for each in meals if each.is_moving]),
        view=chosen.view,
        food_names=food_names(database, filters.food_keys),
        statuses=get_args(MealStatus),
        after_statuses=get_args(AfterStatus),
        known_flags=FLAGS,
        known_failures=FAILURES,
        files=[
            (rows, [(NAMES[output], page.address(**FILE_PARAMETERS, rows=rows, format=output)) for output in outputs])
            for rows, outputs in FILES.items()
            if chosen.reaches(rows) and chosen.told_reversed is None
        ],
    )


def _parts(watched: list[str] | None) -> list[tuple[str, str, str]]:
    found = []
    for one in watched or ():
        participant, client_id, version = one.split(":")
        found.append((participant, client_id, version))
    return found
