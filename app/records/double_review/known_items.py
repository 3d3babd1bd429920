"""Items with a known answer: a picture, its food and grams, sent by an owner. They belong to no participant."""

import tempfile
import uuid
from datetime import UTC, datetime
from pathlib import Path

import sqlalchemy as sa

from app.children.api_children import Whose
from app.core.errors import ConflictError, NotFoundError
from app.db.session import unless_taken
from app.http.state import ApiState
from app.meals.stored.decision_models import KnownItem, ReviewDecision
from app.meals.stored.outline_json import rings_of
from app.people.access import audit
from app.people.access.caller import StaffCaller
from app.people.models import Study
from app.records.double_review.schemas import KnownItemIn
from app.records.review.review_context import named_food
from app.records.serve_photo import MAX_WIDTH_PX, make_picture

KNOWN_ITEMS = uuid.UUID("6c1d60e2-0b0f-4a53-9a5e-3f3a2f0c7a11")  # random namespace


def add_known_item(state: ApiState, caller: StaffCaller, study: Study, body: KnownItemIn) -> None:
    """Keep an item; its picture is made as those of meals are, so that it tells nothing.

    Raises InvalidInputError, ConflictError (`item_exists`), PhotographError, UnavailableError.
    """
    with tempfile.TemporaryDirectory(prefix="tada-", dir=state.blobs.staging_folder()) as name:
        source, target = Path(name) / "photo", Path(name) / "picture.jpg"
        source.write_bytes(body.picture)
        whose = Whose(study.id, caller.staff_id)
        size = make_picture(state, whose, source, target, width_px=MAX_WIDTH_PX)
        picture = target.read_bytes()
    taken = ConflictError("There is already an item with this id.", code="item_exists")
    with unless_taken(taken), state.database.write() as session:
        named_food(session, body.food)
        session.add(
            KnownItem(
                id=id_of(body.id),
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
        )
        audit.note(session, caller, "known_item.add", study_id=study.id, subject=body.id)


def remove_known_item(
    state: ApiState, caller: StaffCaller, study: Study, item_id: uuid.UUID
) -> None:
    """Delete an item, and what reviewers decided about it. Raises NotFoundError."""
    with state.database.write() as session:
        known = session.get(KnownItem, id_of(item_id))
        if known is None or known.study_id != study.id:
            raise NotFoundError("The study has no such item.", code="item_not_found")
        session.execute(sa.delete(ReviewDecision).where(ReviewDecision.item_id == known.id))
        session.delete(known)
        audit.note(session, caller, "known_item.remove", study_id=study.id, subject=item_id)


def id_of(client_id: uuid.UUID) -> uuid.UUID:
    """Return an id of the same version as those of meals' items."""
    return uuid.uuid5(KNOWN_ITEMS, str(client_id))
