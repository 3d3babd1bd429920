"""What people say of what was left: of which item a piece is, or that nothing was left at all."""

import uuid

from app.core.errors import ConflictError, NotFoundError
from app.meals.item_state import LeftoverState
from app.meals.record_models import Leftover
from app.records.project_records import AFTER_MEASURED
from app.records.review.meal_events import Change, Standing


def set_leftover(standing: Standing) -> Change:
    """A piece of the after-meal pair is food left of an item, refuse of it, or of none of the meal's items.

    Raises NotFoundError for a piece or an item that the meal does not have, ConflictError for an item that no longer
    stands or was rejected.
    """
    piece, told = _piece(standing), standing.event.told
    of = uuid.UUID(told["of"]) if told["of"] is not None else None
    leftover_class = told["class"]
    if of is not None and not standing.item(of).is_live:
        raise ConflictError("This item was rejected: nothing of it is left.", code="item_rejected", item=str(of))
    rows = standing.parts.leftovers.get(piece.state.item.id, ())
    row = Leftover(
        after_item_id=piece.state.item.id,
        version=1 + max((each.version for each in rows), default=0),
        item_id=of,
        leftover_class=leftover_class,
        layer=standing.layer,
        event_id=standing.event.id,
        flags=[],
        created_at=standing.now,
    )
    old = {"of": str(piece.of_item_id) if piece.of_item_id is not None else None, "class": piece.leftover_class}
    return Change(old=old, new={"of": told["of"], "class": leftover_class}, rows=[row])


def nothing_left(standing: Standing) -> Change:
    """All was eaten: no after-meal pair need come. Raises ConflictError once a pair was measured, which says more."""
    if standing.meal.after_status in AFTER_MEASURED:
        raise ConflictError(
            "An after-meal pair was measured: say of its pieces what they are (set_leftover).",
            code="after_pair_measured",
        )
    return Change(old={"nothing_left": standing.state.nothing_left}, new={"nothing_left": True})


def _piece(standing: Standing) -> LeftoverState:
    for piece in standing.state.leftovers:
        if piece.state.item.id == standing.event.item_id:
            return piece
    raise NotFoundError("The after-meal pair has no such piece.", code="leftover_not_found")
