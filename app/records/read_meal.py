"""Find, lock and read one meal as its phone or a researcher sees it: photographs, status, items and totals."""

import uuid
from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass, field

from sqlalchemy.orm import Session

from app.candidates.item_candidates import ItemCandidates, candidates_of_records
from app.core.errors import GoneError, NotFoundError
from app.core.logs import bind_log_context
from app.db.session import Database
from app.foods import queries as foods
from app.foods.models import Component, Food
from app.meals.stored import queries as meals
from app.meals.stored.models import Meal, MealImage, PieceDetails
from app.meals.stored.record_models import (
    EffectiveRecord,
    Item,
    ItemFood,
    MassDoubt,
    Run,
    RunArtefact,
)
from app.nutrition.doubt import Doubt, Estimate, estimate
from app.nutrition.mass import AFTER, BEFORE, Mass
from app.nutrition.nutrients import (
    MassTotal,
    NutrientTotal,
    Portion,
    nutrients_in,
    total_mass,
    total_nutrients,
)
from app.people import privacy_queries as privacy
from app.people.access import audit
from app.people.access.caller import Caller, DeviceCaller, require_study, studies_with_role
from app.people.participants import require_in_study
from app.records import queries as records
from app.storage.blob_store import BlobStore

# of a meal that failed or is not measured yet; confirmed without foods, it is 0
NOBODY_KNOWS = MassTotal(None, 0)


@dataclass(frozen=True, slots=True)
class ItemView:
    """An item with its effective record; food and food_assignment are None where it is no food yet.

    per_100_g, nutrients: component number -> content of the food, amount in what was eaten.
    """

    record: EffectiveRecord
    item: Item
    food_assignment: ItemFood | None
    food: Food | None
    candidates: ItemCandidates
    per_100_g: Mapping[str, float]
    nutrients: Mapping[str, Estimate]


@dataclass(frozen=True, slots=True)
class MealView:
    """Everything about one meal, detached from its session.

    after_artefacts: of the after-meal pair's run.
    """

    meal: Meal
    participant_code: str
    study_code: str
    images: tuple[MealImage, ...] = ()
    run: Run | None = None
    artefacts: tuple[RunArtefact, ...] = ()
    items: tuple[ItemView, ...] = ()
    # by number: those that the items have figures of
    components: Mapping[str, Component] = field(default_factory=dict)
    total_mass: MassTotal = NOBODY_KNOWS
    totals: Mapping[str, NutrientTotal] = field(default_factory=dict)
    leftovers: tuple[PieceDetails, ...] = ()
    after_artefacts: tuple[RunArtefact, ...] = ()


def find_meal(
    session: Session, caller: Caller, client_id: uuid.UUID, participant_code: str | None = None
) -> tuple[Meal, str, str]:
    """(meal, participant's code, study's code).

    Of several of the same id, the one that was here first.

    Raises NotFoundError where the caller may not see it, NotAllowedError for a lower role.
    """
    matches = meals.find_meals(
        session,
        client_id,
        participant_id=caller.participant_id if isinstance(caller, DeviceCaller) else None,
        participant_code=participant_code,
        study_ids=studies_with_role(caller),
    )
    if not matches:
        raise NotFoundError("There is no such meal.")
    require_study(caller, matches[0][0].study_id, "meal")
    bind_log_context(meal_id=str(matches[0][0].id))
    return matches[0]


def lock_meal_of(
    session: Session, caller: Caller, client_id: uuid.UUID, participant_code: str | None = None
) -> tuple[Meal, str, str]:
    """Find a meal and lock it until the transaction ends; returns what `find_meal` does.

    The participant is locked before the meal, in the same order as a withdrawal locks them. Raises
    NotFoundError, NotAllowedError, GoneError (`withdrawn`: the phone's participant left meanwhile).
    """
    if isinstance(caller, DeviceCaller):
        require_in_study(session, caller.participant_id)
    meal, participant, study = find_meal(session, caller, client_id, participant_code)
    locked = lock_with_person(session, meal)
    # erased or anonymised while this waited for the lock
    if locked is None or locked.client_id != client_id:
        raise NotFoundError("There is no such meal.")
    return locked, participant, study


def lock_with_person(session: Session, meal: Meal) -> Meal | None:
    """Lock the meal and keep its participant from leaving; None: erased while this waited for the lock."""
    privacy.join_participant(session, meal.participant_id)
    return meals.lock_meal(session, meal.id)


def read_meal(
    database: Database, caller: Caller, client_id: uuid.UUID, participant_code: str | None = None
) -> MealView:
    """The meal, its last run, items and records. Raises NotFoundError."""
    with database.read() as session:
        meal, participant, study = find_meal(session, caller, client_id, participant_code)
        return meal_view(session, meal, participant, study)


def meal_view(session: Session, meal: Meal, participant_code: str, study_code: str) -> MealView:
    """A meal as it is stored by now: nothing of it is projected anew."""
    # phones ask for it most
    is_bare = meal.status in meals.UNESTIMATED and not records.has_results(session, meal.id)
    runs = {} if is_bare else records.last_runs(session, meal.id)
    run, after_run = runs.get("meal"), runs.get("after")
    rows = [] if is_bare else records.items_of_meal(session, meal.id)
    candidates = (
        candidates_of_records(session, [(row.record, row.item) for row in rows]) if rows else {}
    )
    nutrients = (
        foods.nutrients_of_each(session, {row.food.id for row in rows if row.food is not None})
        if rows
        else {}
    )
    contents = {
        food_id: {each.component.number: each.per_100_g for each in amounts}
        for food_id, amounts in nutrients.items()
    }
    items = tuple(
        _item(
            row,
            candidates[row.record.item_id],
            contents[row.food.id] if row.food is not None else {},
        )
        for row in rows
    )
    portions = [portion for item in items for portion in _portions(item)]
    return MealView(
        meal=meal,
        participant_code=participant_code,
        study_code=study_code,
        images=tuple(meals.images_of(session, meal.id)),
        run=run,
        artefacts=tuple(records.artefacts_of(session, run.id)) if run is not None else (),
        items=items,
        components={
            each.component.number: each.component
            for amounts in nutrients.values()
            for each in amounts
        },
        total_mass=total_mass(portions) if portions or meal.status == "confirmed" else NOBODY_KNOWS,
        totals=total_nutrients(portions),
        leftovers=tuple(meal.leftovers),
        after_artefacts=tuple(records.artefacts_of(session, after_run.id))
        if after_run is not None
        else (),
    )


def open_artefact(
    database: Database,
    blobs: BlobStore,
    caller: Caller,
    client_id: uuid.UUID,
    name: str,
    participant_code: str | None,
    purpose: str = "meal",
) -> tuple[RunArtefact, Generator[bytes, None, None]]:
    """An artefact of the last run of the meal's pair (purpose "meal") or its after-meal pair ("after"), and its bytes.

    The reading is noted.

    Raises NotFoundError, GoneError (`photograph_erased`), ConflictError, BlobMissingError.
    """
    with database.read() as session:
        meal, _, _ = find_meal(session, caller, client_id, participant_code)
        run = records.last_runs(session, meal.id).get(purpose)
        artefacts = records.artefacts_of(session, run.id) if run is not None else []
        artefact = next((each for each in artefacts if each.name == name), None)
        is_erased = any(image.erased_at is not None for image in meals.images_of(session, meal.id))
    if artefact is None and is_erased:
        raise GoneError("The pictures of this meal were erased.", code="photograph_erased")
    if artefact is None:
        raise NotFoundError(
            f"This meal has no artefact {name!r}: GET the meal to see which it has."
        )
    with database.write() as session:  # it shows the meal, as its photographs do
        audit.note(
            session,
            caller,
            "photograph.read",
            study_id=meal.study_id,
            subject=meal.alias,
            artefact=name,
        )
    return artefact, blobs.stream(artefact.blob_key)


def _item(
    row: records.ItemRow, candidates: ItemCandidates, per_100_g: Mapping[str, float]
) -> ItemView:
    eaten = row.record.eaten_g
    nutrients = nutrients_in(per_100_g, eaten) if eaten is not None else {}
    return ItemView(
        row.record, row.item, row.food_assignment, row.food, candidates, per_100_g, nutrients
    )


def _portions(view: ItemView) -> Iterator[Portion]:
    """The item as terms of the meal's totals; one without a food counts as one whose mass is not known."""
    record, details = view.record, view.record.details
    if record.status == "rejected":
        return
    food_key = view.food.key if view.food is not None else ""
    if record.consumed_g is None or details["served"] is None:
        yield Portion(food_key, view.per_100_g, None, BEFORE)
        return
    yield Portion(food_key, view.per_100_g, _mass(details["served"]), BEFORE, share=record.share)
    for term in details["left"]:
        yield Portion(food_key, view.per_100_g, _mass(term), AFTER, -1, record.share)


def _mass(term: MassDoubt) -> Mass:
    """Edible grams by themselves, without refuse."""
    doubt = Doubt(term["pair"], term["density"], term["item"])
    edible_g = estimate(term["edible_g"], doubt)
    return Mass(edible_g, edible_g, 1.0, doubt)
