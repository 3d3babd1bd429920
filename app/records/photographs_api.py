"""/v1/meals/{meal_id}/images/{slot}: a meal's photograph for eyes. Each reading stands in the audit log."""

from typing import Annotated, Literal

from fastapi import APIRouter, Header, Query, Request, Response

from app.children.api_children import ApiChildren
from app.http.conditions import is_held
from app.http.parameters import MealId, OfWhichParticipant, Slot
from app.http.problems import problem_responses
from app.http.ranges import answer_part
from app.people.access.deps import CurrentCaller, State
from app.records.serve_photo import find_photo, render_photo

router = APIRouter(prefix="/v1/meals", tags=["meals"])

ATTACHMENT = {
    "description": "`attachment`: of a map or a voice note.",
    "schema": {"type": "string"},
}
MIN_WIDTH_PX, DEFAULT_WIDTH_PX, MAX_WIDTH_PX = 64, 1600, 4096


@router.get(
    "/{meal_id}/images/{slot}",
    response_class=Response,
    responses={
        200: {
            "content": {
                "image/jpeg": {},
                "image/png": {},
                "image/tiff": {},
                "audio/webm": {},
                "audio/mp4": {},
            },
            "description": "The photograph as JPEG, upright, its colours corrected by the marker, without metadata; a "
            "depth or confidence map or a voice note as it is stored.",
            "headers": {
                "Content-Disposition": ATTACHMENT,
                "X-Colour-Correction": {
                    "description": "`colour`: by the board's colours; `white`: by its paper; `none`: as taken.",
                    "schema": {"type": "string", "enum": ["colour", "white", "none"]},
                },
            },
        },
        206: {
            "content": {"image/tiff": {}, "image/png": {}, "audio/webm": {}, "audio/mp4": {}},
            "description": "The part that `Range` asks for, of a map or a voice note.",
            "headers": {"Content-Disposition": ATTACHMENT},
        },
        304: {"description": "The caller has it already; no reading is noted."},
        **problem_responses(401, 403, 404, 409, 410, 416, 422, 500, 503),
    },
)
def get_photograph(
    meal_id: MealId,
    slot: Slot,
    request: Request,
    state: State,
    caller: CurrentCaller,
    width: Annotated[
        int,
        Query(
            ge=MIN_WIDTH_PX, le=MAX_WIDTH_PX, description="At most so many px wide; never enlarged."
        ),
    ] = DEFAULT_WIDTH_PX,
    colour: Annotated[
        Literal["corrected", "as_taken"],
        Query(description="By default as the newest run of the pair corrects it, where it could."),
    ] = "corrected",
    participant: OfWhichParticipant = None,
    if_none_match: Annotated[
        str | None,
        Header(
            max_length=500,
            description="The ETag of what is there already: 304 if it has not changed.",
        ),
    ] = None,
) -> Response:
    """A photograph as JPEG, or the file of a map or voice note, for the study's staff and the phone that sent it."""
    photo = find_photo(
        state.database, caller, meal_id, slot, participant, as_taken=colour == "as_taken"
    )
    headers = {
        "ETag": photo.etag(width),
        "Cache-Control": "private, max-age=0, must-revalidate",  # erased is erased: each use asks first
        "X-Colour-Correction": photo.colour_kind,
    }
    if is_held(if_none_match, headers["ETag"]):
        return Response(status_code=304, headers=headers)
    content = render_photo(
        state.database, state.blobs, state.part(ApiChildren), state.settings, caller, photo, width
    )
    if photo.is_file:  # data, not a picture for a browser
        return answer_part(
            request, content, photo.media_type, headers | {"Content-Disposition": "attachment"}
        )
    return Response(content, media_type=photo.media_type, headers=headers)
