"""/v1/meals/{meal_id}/images/{slot}: a meal's photograph for eyes; each reading is noted.

The picture is upright, its colours corrected by the marker, without metadata.

The correction is that of the newest run of the photograph's pair; without one (not measured yet,
marker not found, measured before there were corrections) the picture is as it was taken.

At the width of a thumbnail it is the one that this run has left, which costs no child a moment;
without one, or where it is not to be read, it is made like all others.
"""

import hashlib
import json
import tempfile
import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import structlog
from fastapi import APIRouter, Header, Query, Request, Response
from sqlalchemy.orm import Session

from app.children.api_children import ApiChildren, PhotographError, Whose
from app.core.errors import GoneError, NotFoundError, TadaError
from app.db.session import Database
from app.http.parameters import MealId, OfWhichParticipant, Slot, is_held
from app.http.problems import problem_responses
from app.http.ranges import answer_part
from app.http.state import ApiState
from app.meals.stored import queries as meals
from app.meals.stored.models import Meal, MealImage
from app.meals.stored.receive_photo import sha256_of_file
from app.meals.stored.record_models import Run, RunArtefact
from app.meals.stored.run_answer import THUMBNAIL_PX, thumbnail_name
from app.people.access import audit
from app.people.access.caller import Caller, StaffCaller
from app.people.access.deps import CurrentCaller, State
from app.photos.inspect import COSTLY_PIXELS
from app.photos.slots import AFTER_SLOTS, FILE_SLOTS, image_name
from app.records import queries as records
from app.records.read_meal import find_meal
from app.storage.blob_store import BlobMissingError, BlobStore

log = structlog.get_logger()

SECONDS = 20.0  # of one photograph: 60 megapixels of HEIC take some five on a slow machine
VERSION = "2"  # of how pictures are made; another one makes other tags


class PhotoDamagedError(TadaError):
    """The sealed bytes are not those that were sealed."""

    code = "photo_damaged"
    status = 500


@dataclass(frozen=True, slots=True)
class StoredPhoto:
    """A photograph that the caller may see.

    colour: its correction (estimate_json), None: to be shown as taken
    thumbnail: the small picture that is kept of it, in these colours
    """

    image: MealImage
    study_id: uuid.UUID
    meal_alias: uuid.UUID
    colour: Mapping[str, Any] | None
    thumbnail: RunArtefact | None = None

    @property
    def is_file(self) -> bool:
        """Return whether it is a map or a voice note, which is returned as it is stored."""
        return self.image.slot in FILE_SLOTS

    @property
    def media_type(self) -> str:
        """Return the media type of the file that is returned."""
        return self.image.media_type if self.is_file else "image/jpeg"

    @property
    def colour_kind(self) -> str:
        """What corrects its colours: "colour" or "white" of the marker, or "none"."""
        return str(self.colour["kind"]) if self.colour is not None else "none"

    def etag(self, width_px: int) -> str:
        """Of the picture at this width, in these colours."""
        if self.thumbnail is not None and width_px == THUMBNAIL_PX:
            return f'"{self.thumbnail.sha256[:32]}"'
        name = f"{VERSION} {self.image.stored_sha256} {width_px} {json.dumps(self.colour, sort_keys=True)}"
        return f'"{hashlib.sha256(name.encode()).hexdigest()[:32]}"'


def find_photo(
    database: Database,
    caller: Caller,
    client_id: uuid.UUID,
    slot: str,
    participant_code: str | None,
    *,
    as_taken: bool = False,
) -> StoredPhoto:
    """The photograph of a slot, with its colour correction unless it is wanted as taken.

    Raises NotFoundError, GoneError (`photograph_erased`, `meal_deleted`), ConflictError.
    """
    with database.read() as session:
        meal, _, _ = find_meal(session, caller, client_id, participant_code)
        image = next(
            (each for each in meals.images_of(session, meal.id) if each.slot == slot), None
        )
        run = None if as_taken or slot in FILE_SLOTS else _run_on(session, meal, slot)
        kept = records.artefacts_of(session, run.id) if run is not None else []
    if image is None:
        raise NotFoundError(f"This meal has no {image_name(slot)}.")
    if image.erased_at is not None:
        raise _erased()
    thumbnail = next((each for each in kept if each.name == thumbnail_name(slot)), None)
    return StoredPhoto(image, meal.study_id, meal.alias, _colour_of(run, slot), thumbnail)


def render_photo(state: ApiState, caller: Caller, found: StoredPhoto, width_px: int) -> bytes:
    """The picture as JPEG, or the file of a map or a voice note, the reading of it noted before it is given out.

    Raises BlobMissingError, PhotoDamagedError, UnavailableError, PhotographError.
    """
    image = found.image
    content = _kept(state.blobs, found.thumbnail) if width_px == THUMBNAIL_PX else None
    if content is None:
        content = _made(state, caller, found, width_px)
    with state.database.write() as session:
        still = session.get(MealImage, image.id)
        if still is None or still.erased_at is not None:  # meanwhile
            raise _erased()
        audit.note(
            session,
            caller,
            "photograph.read",
            study_id=found.study_id,
            subject=found.meal_alias,
            slot=image.slot,
            width_px=width_px,
        )
    return content


def _kept(blobs: BlobStore, thumbnail: RunArtefact | None) -> bytes | None:
    """The small picture as it was sealed; None: there is none that could be shown."""
    if thumbnail is None:
        return None
    try:
        content = blobs.read(thumbnail.blob_key)
    except BlobMissingError:
        log.exception("thumbnail_missing", blob_key=thumbnail.blob_key)
        return None
    if hashlib.sha256(content).hexdigest() != thumbnail.sha256:
        log.error("thumbnail_damaged", blob_key=thumbnail.blob_key)
        return None
    return content


def _made(state: ApiState, caller: Caller, found: StoredPhoto, width_px: int) -> bytes:
    """The picture, made of the photograph by a child."""
    image, blobs = found.image, state.blobs
    with tempfile.TemporaryDirectory(prefix="tada-", dir=blobs.staging_folder()) as name:
        source, target = Path(name) / "photo", Path(name) / "picture.jpg"
        blobs.fetch(image.blob_key, source)
        if sha256_of_file(source) != image.stored_sha256:
            log.error("photo_damaged", blob_key=image.blob_key)
            raise PhotoDamagedError(
                "The photograph is no longer what was sealed: `tada doctor` tells more."
            )
        if found.is_file:
            return source.read_bytes()
        caller_id = caller.staff_id if isinstance(caller, StaffCaller) else caller.device_id
        make_picture(
            state,
            Whose(found.study_id, caller_id),
            source,
            target,
            width_px=width_px,
            colour=found.colour,
            sha256=image.stored_sha256,
            is_costly=(image.decoding_pixels or 0) > COSTLY_PIXELS,
        )
        return target.read_bytes()


def make_picture(
    state: ApiState,
    whose: Whose,
    source: Path,
    target: Path,
    *,
    width_px: int,
    colour: Mapping[str, Any] | None = None,
    sha256: str | None = None,
    is_costly: bool = False,
) -> Mapping[str, Any]:
    """Have a child write a photograph as upright JPEG; return its width and height.

    Raises PhotographError, UnavailableError.
    """
    answer = state.part(ApiChildren).run(
        "picture",
        {
            "photo": str(source),
            "output": str(target),
            "width_px": width_px,
            "max_pixels": state.settings.max_photo_pixels,
            "colour": colour,
        },
        seconds=SECONDS,
        whose=whose,
        photograph_sha256=sha256,
        is_costly=is_costly,
    )
    if answer["failure"] is not None:
        raise PhotographError(answer["failure"]["message"], code=answer["failure"]["code"])
    return answer


def _run_on(session: Session, meal: Meal, slot: str) -> Run | None:
    """The newest run on the photograph's pair."""
    is_after = slot in AFTER_SLOTS
    # a failed pair's run is not of the one sent in its place
    if is_after and meal.after_status in meals.UNESTIMATED:
        return None
    return records.last_runs(session, meal.id).get("after" if is_after else "meal")


def _colour_of(run: Run | None, slot: str) -> Mapping[str, Any] | None:
    if run is None or run.colour is None:
        return None
    # of further views there is none
    colour: Mapping[str, Any] | None = run.colour.get(slot.removeprefix("after_"))
    return colour if colour is not None and colour["kind"] != "none" else None


def _erased() -> GoneError:
    return GoneError(
        "This photograph was erased, as the study's protocol asks.", code="photograph_erased"
    )


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
    content = render_photo(state, caller, photo, width)
    if photo.is_file:  # data, not a picture for a browser
        return answer_part(
            request, content, photo.media_type, headers | {"Content-Disposition": "attachment"}
        )
    return Response(content, media_type=photo.media_type, headers=headers)
