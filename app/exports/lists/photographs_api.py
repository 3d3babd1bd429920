"""/v1/studies/{study}/photographs: the image manifest, JSON pages or one file."""

from typing import cast

from fastapi import APIRouter, Request
from fastapi.responses import Response

from app.exports.export_files import FILES, Format, answer_file, day_filter, file_spec, page_or_file
from app.exports.known_filters import require_known
from app.exports.lists.list_photographs import ListedPhotograph, list_photographs
from app.exports.lists.photograph_schemas import PhotographOut, PhotographPage
from app.http.model_response import ModelResponse
from app.http.paging import Cursor, Limit
from app.http.parameters import FirstDay, LastDay, OfParticipant, StudyCode
from app.people.access.deps import CurrentStaff, State
from app.photos.slots import ImageSlot

router = APIRouter(prefix="/v1/studies", tags=["meals"])


@router.get(
    "/{study}/photographs",
    response_model=PhotographPage,
    responses=page_or_file(FILES, 401, 403, 404, 422, 503),
)
def get_photographs(
    request: Request,
    study: StudyCode,
    state: State,
    caller: CurrentStaff,
    participant: OfParticipant = None,
    first_day: FirstDay = None,
    last_day: LastDay = None,
    limit: Limit = 100,
    cursor: Cursor = None,
    output: Format = None,
) -> Response:
    """One row per photograph with its hashes."""
    chosen = day_filter(study, participant, first_day, last_day)
    require_known(state.database, caller, chosen)
    spec = file_spec(request, "photographs", chosen, output)
    if spec is not None:
        return answer_file(state, caller, spec)
    page = list_photographs(state.database, caller, chosen, cursor=cursor, limit=limit)
    return ModelResponse(PhotographPage.of(request, page, _out))


def _out(photograph: ListedPhotograph) -> PhotographOut:
    image, meal = photograph.image, photograph.meal
    return PhotographOut(
        meal_id=meal.client_id,
        study=photograph.study,
        participant=photograph.participant,
        captured_at=meal.captured_at,
        local_date=meal.local_date,
        slot=cast("ImageSlot", image.slot),
        media_type=image.media_type,
        width_px=image.width_px,
        height_px=image.height_px,
        bytes=image.bytes,
        received_sha256=image.received_sha256,
        stored_sha256=image.stored_sha256,
        received_at=image.received_at,
        erased=image.erased_at is not None,
        erased_at=image.erased_at,
        path=photograph.path,
    )
