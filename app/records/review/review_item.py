"""Rules of events about one item: confirm, reject, its food, amount, share and outline, answers to its food's probes.

Each rule checks the event against the current item and returns the old and new values with the rows
that follow. A probe asks for something beside or in a food: fat, sugar, dressing, milk, salt.
`drained` asks what the food is: it creates no item, but may name the food that it is then (the same
in syrup, or drained).
"""

from app.core.errors import ConflictError, InvalidInputError
from app.foods.models import Food
from app.meals.stored.item_state import ItemState
from app.records.queries import artefacts_of, last_runs
from app.records.review.review_context import (
    DECLARED_SD,
    STATED_SD,
    Change,
    ReviewContext,
    assign_food,
    food_key,
    named_food,
    new_item,
    remeasure_job,
    require_complete,
    stated_amount,
)
from app.records.review.schemas import (
    MOST_ML,
    AmountIn,
    ConfirmIn,
    DeclareIn,
    RedrawIn,
    RejectIn,
    ReshapeIn,
    SetFoodIn,
    SetMassIn,
    SetShareIn,
    SetVolumeIn,
)
from app.vision.hand_form import hand_form_ml

SCENE = "scene.json"  # written by vision/scene_file.py, which an API process does not import
# probes whose answer says what the food is, not what came with it
ABOUT_THE_FOOD = frozenset({"drained"})


def confirm(context: ReviewContext, event: ConfirmIn) -> Change:
    """Confirm the item. Raises ConflictError if it is incomplete."""
    state = context.item(event.item)
    require_complete([state])
    status = "corrected" if state.decision == "corrected" else "confirmed"
    return Change(old={"status": context.record(state).status}, new={"status": status})


def reject(context: ReviewContext, event: RejectIn) -> Change:
    """Exclude the item from all totals.

    A later event of the same layer about the item includes it again.
    """
    state = context.item(event.item)
    return Change(old={"status": context.record(state).status}, new={"status": "rejected"})


def set_food(context: ReviewContext, event: SetFoodIn) -> Change:
    """Assign the item to a food; its mass follows anew from its volume."""
    state = context.item(event.item)
    food = named_food(context.session, event.food)
    row = assign_food(
        context, event.item, food, event.lies_as, context.parts.foods.get(event.item, ())
    )
    old_lies_as = state.food_assignment.lies_as if state.food_assignment is not None else None
    return Change(
        old={"food": food_key(context.session, state.food_assignment), "lies_as": old_lies_as},
        new={"food": food.key, "lies_as": event.lies_as},
        rows=[row],
    )


def set_volume(context: ReviewContext, event: SetVolumeIn) -> Change:
    """Set the volume of an item or of a piece of the after-meal pair."""
    state = context.item_or_piece(event.item)
    return Change(
        old=_current_amount(state),
        new={**stated_amount(context.session, event.amount(), None, STATED_SD)},
    )


def set_mass(context: ReviewContext, event: SetMassIn) -> Change:
    """Set grams or household measures of an item or of a piece of the after-meal pair."""
    state = context.item_or_piece(event.item)
    food = (
        context.session.get_one(Food, state.food_assignment.food_id)
        if state.food_assignment is not None
        else None
    )
    return Change(
        old=_current_amount(state),
        new={**stated_amount(context.session, event.amount(), food, STATED_SD)},
    )


def set_share(context: ReviewContext, event: SetShareIn) -> Change:
    """Set the participant's share of a shared dish."""
    return Change(old={"share": context.item(event.item).share}, new={"share": event.share})


def redraw(context: ReviewContext, event: RedrawIn) -> Change:
    """Replace the item's outline and queue its measurement."""
    state = context.item(event.item)
    return Change(
        old={"polygon": [list(ring) for ring in state.rings]},
        new=event.model_dump(mode="json", include={"polygon"}),
        rows=[remeasure_job(context)],
    )


def reshape(context: ReviewContext, event: ReshapeIn) -> Change:
    """Set the item's volume to that of a form in the table's frame of the meal's run.

    Raises ConflictError (`scene_missing`: no run has such a frame), InvalidInputError
    (`form_too_large`).
    """
    state, run = context.item(event.item), last_runs(context.session, context.meal.id).get("meal")
    names = (
        {artefact.name for artefact in artefacts_of(context.session, run.id)}
        if run is not None
        else set()
    )
    if run is None or run.failure_code is not None or SCENE not in names:
        raise ConflictError(
            "The meal has no measured scene in which a form could stand: set the amount instead.",
            code="scene_missing",
        )
    form = event.form
    volume_ml = hand_form_ml(form.section, form.length_mm, form.width_mm, form.height_mm)
    if volume_ml > MOST_ML:
        raise InvalidInputError(
            f"The form holds more than {MOST_ML} ml: check its sizes, which are in mm.",
            code="form_too_large",
            limit_ml=MOST_ML,
        )
    amount = AmountIn(volume_ml=volume_ml, relative_sd=event.relative_sd)
    return Change(
        old=_current_amount(state),
        new={
            "form": form.model_dump(mode="json"),
            "run": str(run.id),
            **stated_amount(context.session, amount, None, STATED_SD),
        },
    )


def declare(context: ReviewContext, event: DeclareIn) -> Change:
    """Answer a probe of the item.

    Raises InvalidInputError (no probe of its food), ConflictError (answered).
    """
    state, session = context.item(event.item), context.session
    probes = (
        session.get_one(Food, state.food_assignment.food_id).probes
        if state.food_assignment is not None
        else []
    )
    if event.probe not in probes:
        raise InvalidInputError(
            "The item's food has no such probe: `open_probes` of the item lists its probes.",
            code="probe_unknown",
            probes=list(probes),
        )
    if event.probe in context.state.answers[event.item]:
        raise ConflictError(
            "This was answered: undo the answer to give another.", code="probe_answered"
        )
    answer = {"probe": event.probe, "answer": event.answer}
    if event.food is None:
        if event.answer == "yes" and event.probe not in ABOUT_THE_FOOD:
            raise InvalidInputError(
                "Name in `food` what was added, and how much of it.", code="declared_food_missing"
            )
        return Change(new=answer)
    food = named_food(session, event.food)
    if event.probe in ABOUT_THE_FOOD:
        row = assign_food(context, event.item, food, None, context.parts.foods.get(event.item, ()))
        return Change(new=answer | {"food": food.key}, rows=[row])
    item = new_item(context, "declared", parent_id=event.item)
    amount = stated_amount(session, event.amount, food, DECLARED_SD)
    return Change(
        new={**answer, "food": food.key, "item": str(item.id), "share": event.share, **amount},
        rows=[item, assign_food(context, item.id, food, None)],
    )


def _current_amount(state: ItemState) -> dict[str, object]:
    """Return the item's amount in the fields of the API."""
    amount = state.amount
    if amount.mass is not None:
        return {"mass_g": amount.mass.mass_g, "of": amount.mass.of}
    return {"volume_ml": amount.volume_ml}
