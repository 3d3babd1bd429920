"""Items with a known answer: a picture, its food and grams, sent by an owner. They belong to no participant."""

import tempfile
import uuid
from datetime import UTC, datetime
from pathlib import Path

from app.children.api_children import Whose
from app.http.state import ApiState
from app.meals.stored.decision_models import KnownItem
from app.meals.stored.outline_json import rings_of
from app.people.access import audit
from app.people.access.caller import StaffCaller
from app.people.models import Study
from app.records.double_review.schemas import KnownItemIn
from app.records.review.review_context import named_food
from app.records.serve_photo import MAX_WIDTH_PX, make_picture


def put_known_item(
    state: ApiState, caller: StaffCaller, study: Study, client_id: uuid.UUID, body: KnownItemIn
) -> None:
    """Keep an item, or replace it; its picture is made as those of meals are, so that it tells nothing.

    Raises InvalidInputError, PhotographError, UnavailableError.
    """
    with tempfile.TemporaryDirectory(prefix="tada-", dir=state.blobs.staging_folder()) as name:
        source, target = Path(name) / "photo", Path(name) / "picture.jpg"
        source.write_bytes(body.picture)
        whose = Whose(study.id, caller.staff_id)
        size = make_picture(state, whose, source, target, width_px=MAX_WIDTH_PX)
        picture = target.read_bytes()
    kept = KnownItem(
        id=known_item_id(study, client_id),
        study_id=study.id,
        food_key=body.food,
        mass_g=body.mass_g,
        shown_g=body.shown_g,
        rings=rings_of(body.model_dump()["polygon"]),
        picture=picture,
        width_px=size["width"],
        height_px=size["height"],
        created_at=datetime.now(UTC),
    )
    with state.database.write() as session:
        named_food(session, body.food)
        session.merge(kept)
        audit.note(session, caller, "known_item.put", study_id=study.id, subject=client_id)


def known_item_id(study: Study, client_id: uuid.UUID) -> uuid.UUID:
    """Return an id of the same version as those of meals' items."""
    return uuid.uuid5(study.id, str(client_id))
