"""/v1/meals as a list; how many meals of a study have each status; which of those on a page have changed."""

import uuid
from typing import Annotated, Literal
from urllib.parse import quote

from fastapi import APIRouter, Query, Request
from fastapi.responses import JSONResponse, Response
from pydantic import StringConstraints

from app.core.errors import InvalidInputError
from app.exports.export_files import (
    FILES_WITH_PLACES,
    ComponentsIn,
    Format,
    LayoutIn,
    ProvenanceIn,
    answer_file,
    file_format,
)
from app.exports.export_spec import ExportFilters, ExportSpec
from app.exports.lists.list_meals import MOST_WATCHED, changed_meals, count_meals, list_meals, sums_of
from app.exports.lists.meal_page_queries import MealFilter
from app.exports.lists.meal_row_queries import MealRow
from app.exports.lists.meal_schemas import (
    ChangedMeals,
    MealCounts,
    MealLinks,
    MealListItem,
    MealPage,
    StatusCountOut,
)
from app.http.day_order import require_order
from app.http.paging import Cursor, Limit, next_page
from app.http.parameters import FirstDay, LastDay, OfParticipant, OfStudy, StudyCode
from app.http.problems import problem_responses
from app.meals.models import AfterStatus, MealOrigin, MealStatus
from app.people.access.caller import Caller, DeviceCaller
from app.people.access.deps import CurrentCaller, CurrentStaff, State
from app.people.studies import read_study
from app.records.render import food_ref

router = APIRouter(prefix="/v1", tags=["meals"])

FoodKey = Annotated[str, StringConstraints(max_length=100)]
Word = Annotated[str, StringConstraints(max_length=64, pattern="^[a-z0-9_]+$")]
Known = Annotated[str, StringConstraints(max_length=50, pattern=r"^[0-9A-Fa-f-]{32,36}:[0-9]{1,9}$")]
MOST_VALUES = 10  # of one filter, any of which will do


@router.get(
    "/meals",
    response_model=MealPage,
    responses={
        200: {"content": FILES_WITH_PLACES, "description": "A page, or all rows as a file."},
        **problem_responses(401, 422, 503),
    },
)
def get_meals(
    request: Request,
    state: State,
    caller: CurrentCaller,
    study: OfStudy = None,
    participant: OfParticipant = None,
    first_day: FirstDay = None,
    last_day: LastDay = None,
    status: Annotated[
        list[MealStatus] | None, Query(max_length=7, description="The meals' status; any of several.")
    ] = None,
    origin: Annotated[
        MealOrigin | None,
        Query(description="Whether the meal was photographed, or declared without photographs."),
    ] = None,
    failure: Annotated[
        list[Word] | None, Query(max_length=MOST_VALUES, description="A failure's code; any of several.")
    ] = None,
    after_status: Annotated[
        list[AfterStatus] | None, Query(max_length=7, description="How the after-meal pair stands; any of several.")
    ] = None,
    food: Annotated[
        list[FoodKey] | None,
        Query(max_length=MOST_VALUES, description="The key of a food of an item; any of several."),
    ] = None,
    flag: Annotated[
        list[Word] | None, Query(max_length=MOST_VALUES, description="A flag of an item; any of several.")
    ] = None,
    needs: Annotated[
        Literal["review", "answer"] | None,
        Query(description="review: an item is in the review queue; answer: a question to the participant is open."),
    ] = None,
    order: Annotated[Literal["newest", "oldest"], Query(description="Which come first.")] = "newest",
    limit: Limit = 100,
    cursor: Cursor = None,
    output: Format = None,
    layout: LayoutIn = "wide",
    components: ComponentsIn = "headline",
    provenance: ProvenanceIn = True,
) -> Response:
    """Meals by time of capture. Items that were rejected count nowhere: not in the filters, not in the figures.

    A file has all that the filters leave, of one moment, the oldest first.
    """
    output = file_format(request, output, layout, components)
    if output is not None:
        filters = ExportFilters(
            study,
            participant,
            first_day,
            last_day,
            food_keys=tuple(food or ()),
            statuses=tuple(status or ()),
            flags=tuple(flag or ()),
            origin=origin,
            needs=needs,
            failure_codes=tuple(failure or ()),
            after_statuses=tuple(after_status or ()),
        )
        spec = ExportSpec("meals", layout, output, components, filters, provenance)
        return answer_file(state, caller, spec, "meals")
    require_order(first_day, last_day)
    chosen = MealFilter(
        study_code=study,
        participant_code=participant,
        first_day=first_day,
        last_day=last_day,
        statuses=tuple(status or ()),
        origin=origin,
        failure_codes=tuple(failure or ()),
        after_statuses=tuple(after_status or ()),
        food_keys=tuple(food or ()),
        flags=tuple(flag or ()),
        needs=needs,
    )
    page = list_meals(state.database, caller, chosen, order=order, cursor=cursor, limit=limit)
    body = MealPage(items=[render_meal_row(row, caller) for row in page.rows], next=next_page(request, page.cursor))
    return JSONResponse(body.model_dump(mode="json"))


@router.get("/studies/{study}/meal-counts", responses=problem_responses(401, 403, 404))
def get_meal_counts(study: StudyCode, state: State, _: CurrentStaff) -> MealCounts:
    """How many meals of the study have each status; of more than 1,000 it is said that there are more."""
    counts = count_meals(state.database, read_study(state.database, study).id)
    return MealCounts(items=[StatusCountOut.model_validate(count, from_attributes=True) for count in counts])


@router.get("/studies/{study}/changed-meals", responses=problem_responses(401, 403, 404, 422))
def get_changed_meals(
    study: StudyCode,
    state: State,
    caller: CurrentStaff,
    meal: Annotated[
        list[Known] | None,
        Query(max_length=MOST_WATCHED, description="ID:VERSION, as they are known; several."),
    ] = None,
) -> ChangedMeals:
    """Which of these meals have changed, as they stand now: what a page that shows them asks every few seconds."""
    known = [_known(text) for text in meal or ()]
    rows = changed_meals(state.database, read_study(state.database, study).id, known)
    return ChangedMeals(items=[render_meal_row(row, caller) for row in rows])


def render_meal_row(row: MealRow, caller: Caller) -> MealListItem:
    """A meal of a list as the API shows it. Staff's links name the participant: a phone's id alone may be two meals."""
    meal, sums = row.meal, sums_of(row)
    path = f"/v1/meals/{meal.client_id}"
    whose = "" if isinstance(caller, DeviceCaller) else f"?participant={quote(row.participant_code, safe='')}"
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
        links=MealLinks(meal=f"{path}{whose}", photograph_left=f"{path}/images/left{whose}" if row.has_left else None),
    )


def _known(text: str) -> tuple[uuid.UUID, int]:
    """Raises InvalidInputError where the id is none."""
    client_id, _, version = text.partition(":")
    try:
        return uuid.UUID(client_id), int(version)
    except ValueError:
        raise InvalidInputError(f"{client_id} is no id of a meal.") from None
