"""/v1/meals as a list, counts of a study's meals by status, and which of some meals have changed."""

import uuid
from typing import Annotated, Literal
from urllib.parse import quote

from fastapi import APIRouter, Depends, Query, Request
from fastapi.responses import Response
from pydantic import StringConstraints

from app.core.errors import InvalidInputError
from app.exports.export_files import (
    FILES_WITH_PLACES,
    ComponentsIn,
    Format,
    LayoutIn,
    ProvenanceIn,
    answer_file,
    file_spec,
    meal_filter,
    page_or_file,
)
from app.exports.known_filters import require_known
from app.exports.lists.list_meals import (
    MOST_WATCHED,
    changed_meals,
    count_meals,
    list_meals,
    sums_of,
)
from app.exports.lists.meal_row_queries import MealRow
from app.exports.lists.meal_schemas import (
    ChangedMeals,
    MealCounts,
    MealLinks,
    MealListItem,
    MealPage,
    StatusCountOut,
)
from app.http.model_response import ModelResponse
from app.http.paging import Cursor, Limit
from app.http.parameters import StudyCode
from app.http.problems import problem_responses
from app.http.row_filter import RowFilter
from app.people.access.caller import Caller, DeviceCaller
from app.people.access.deps import CurrentCaller, CurrentStaff, State
from app.people.studies import read_study
from app.records.render import food_ref

router = APIRouter(prefix="/v1", tags=["meals"], responses=problem_responses(401, 404))

MealVersion = Annotated[
    str, StringConstraints(max_length=50, pattern=r"^[0-9A-Fa-f-]{32,36}:[0-9]{1,9}$")
]


@router.get(
    "/meals",
    response_model=MealPage,
    responses=page_or_file(FILES_WITH_PLACES, 422, 503),
)
def get_meals(
    request: Request,
    state: State,
    caller: CurrentCaller,
    chosen: Annotated[RowFilter, Depends(meal_filter)],
    order: Annotated[
        Literal["newest", "oldest"], Query(description="Which come first.")
    ] = "newest",
    limit: Limit = 100,
    cursor: Cursor = None,
    output: Format = None,
    layout: LayoutIn = "wide",
    components: ComponentsIn = "headline",
    provenance: ProvenanceIn = True,
) -> Response:
    """Meals by time of capture. Rejected items count neither in filters nor in figures.

    A file has all matching rows of one moment, the oldest first.
    """
    require_known(state.database, caller, chosen)
    spec = file_spec(request, "meals", chosen, output, layout, components, provenance=provenance)
    if spec is not None:
        return answer_file(state, caller, spec)
    page = list_meals(state.database, caller, chosen, order=order, cursor=cursor, limit=limit)
    return ModelResponse(MealPage.of(request, page, lambda row: render_meal_row(row, caller)))


@router.get("/studies/{study}/meal-counts", responses=problem_responses(403))
def get_meal_counts(study: StudyCode, state: State, _: CurrentStaff) -> MealCounts:
    """The study's number of meals by status, up to 1,000 each."""
    counts, needs_look = count_meals(state.database, read_study(state.database, study).id)
    items = [StatusCountOut.model_validate(count, from_attributes=True) for count in counts]
    return MealCounts(items=items, needs_look=needs_look)


@router.get("/studies/{study}/changed-meals", responses=problem_responses(403, 422))
def get_changed_meals(
    study: StudyCode,
    state: State,
    caller: CurrentStaff,
    meal: Annotated[
        list[MealVersion] | None,
        Query(max_length=MOST_WATCHED, description="ID:VERSION as the client has it; several."),
    ] = None,
) -> ChangedMeals:
    """Those of these meals that have changed, for pages that poll the meals that they show."""
    versions = [_parse_version(text) for text in meal or ()]
    rows = changed_meals(state.database, read_study(state.database, study).id, versions)
    return ChangedMeals(items=[render_meal_row(row, caller) for row in rows])


def render_meal_row(row: MealRow, caller: Caller) -> MealListItem:
    """Render a meal of a list. Links for staff name the participant, since a phone's id alone is not unique."""
    meal, sums = row.meal, sums_of(row)
    path = f"/v1/meals/{meal.client_id}"
    query = (
        ""
        if isinstance(caller, DeviceCaller)
        else f"?participant={quote(row.participant_code, safe='')}"
    )
    return MealListItem(
        id=meal.client_id,
        study=row.study_code,
        participant=row.participant_code,
        status=meal.status,
        stage=meal.stage,
        failure_code=meal.failure_code,
        captured_at=meal.captured_at,
        time_zone=meal.time_zone,
        local_date=meal.local_date,
        received_at=meal.received_at,
        upload_delay_seconds=(meal.received_at - meal.captured_at).total_seconds(),
        origin=meal.origin,
        after_status=meal.after_status,
        provisional=sums.provisional,
        version=meal.version,
        item_count=sums.items,
        foods=[ref for ref in map(food_ref, sums.foods) if ref is not None],
        consumed_g=sums.consumed_g,
        energy_kcal=sums.energy_kcal,
        unmeasured_items=sums.unmeasured,
        items_without_energy=sums.without_energy,
        doubt=sums.doubt,
        flags=list(sums.flags),
        links=MealLinks(
            meal=f"{path}{query}",
            photograph_left=f"{path}/images/left{query}" if row.has_left else None,
        ),
    )


def _parse_version(text: str) -> tuple[uuid.UUID, int]:
    """Read ID:VERSION. Raises InvalidInputError."""
    client_id, _, version = text.partition(":")
    try:
        return uuid.UUID(client_id), int(version)
    except ValueError:
        raise InvalidInputError(f"{client_id} is no id of a meal.") from None
