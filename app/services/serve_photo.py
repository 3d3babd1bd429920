"""A meal's photograph for eyes: upright, without metadata, no wider than asked for; each reading is noted."""

import hashlib
import tempfile
import uuid
from dataclasses import dataclass
from pathlib import Path

import structlog

from app.db.models import MealImage
from app.db.queries import meals
from app.db.session import Database
from app.errors import GoneError, NotFoundError, TadaError
from app.services import audit
from app.services.api_children import ApiChildren, PhotographError
from app.services.caller import Caller
from app.services.read_meal import find_meal
from app.services.receive_photo import sha256_of_file
from app.settings import Settings
from app.storage.blob_store import BlobStore

log = structlog.get_logger()

SECONDS = 20.0  # of one photograph: 60 megapixels of HEIC take some five on a slow machine
VERSION = "1"  # of how pictures are made; another one makes other tags


class PhotoDamagedError(TadaError):
    """The sealed bytes are not those that were sealed."""

    code = "photo_damaged"
    status = 500


@dataclass(frozen=True, slots=True)
class FoundPhoto:
    """A photograph that the caller may see."""

    image: MealImage
    study_id: uuid.UUID
    meal_alias: uuid.UUID

    def etag(self, width_px: int) -> str:
        """Of the picture at this width."""
        name = f"{VERSION} {self.image.stored_sha256} {width_px}"
        return f'"{hashlib.sha256(name.encode()).hexdigest()[:32]}"'


def find_photo(
    database: Database, caller: Caller, client_id: uuid.UUID, slot: str, participant_code: str | None
) -> FoundPhoto:
    """The photograph of a slot.

    Raises NotFoundError, GoneError (`photograph_erased`, `meal_deleted`), ConflictError.
    """
    with database.read() as session:
        meal, _, _ = find_meal(session, caller, client_id, participant_code)
        image = next((one for one in meals.images_of(session, meal.id) if one.slot == slot), None)
    if image is None:
        raise NotFoundError(f"This meal has no photograph {slot!r}.")
    if image.erased_at is not None:
        raise _erased()
    return FoundPhoto(image, meal.study_id, meal.alias)


def render_photo(
    database: Database,
    blobs: BlobStore,
    children: ApiChildren,
    settings: Settings,
    caller: Caller,
    found: FoundPhoto,
    width_px: int,
) -> bytes:
    """The picture as JPEG, the reading of it noted before it is given out.

    Raises BlobMissingError, PhotoDamagedError, UnavailableError, PhotographError.
    """
    image = found.image
    with tempfile.TemporaryDirectory(prefix="tada-", dir=blobs.staging_folder()) as name:
        source, target = Path(name) / "photo", Path(name) / "picture.jpg"
        blobs.fetch(image.blob_key, source)
        if sha256_of_file(source) != image.stored_sha256:
            log.error("photo_damaged", blob_key=image.blob_key)
            raise PhotoDamagedError("The photograph is no longer what was sealed: `tada doctor` tells more.")
        answer = children.run(
            "picture",
            {
                "photo": str(source),
                "output": str(target),
                "width_px": width_px,
                "max_pixels": settings.max_photo_pixels,
            },
            seconds=SECONDS,
        )
        if answer["failure"] is not None:
            raise PhotographError(answer["failure"]["message"], code=answer["failure"]["code"])
        content = target.read_bytes()
    with database.write() as session:
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


def _erased() -> GoneError:
    return GoneError("This photograph was erased, as the study's protocol asks.", code="photograph_erased")
