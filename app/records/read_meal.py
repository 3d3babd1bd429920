"""One meal as the phone or a researcher sees it: what has arrived, where it stands, what was found."""

import uuid
from collections.abc import Generator, Iterable, Iterator, Mapping
from dataclasses import dataclass

from sqlalchemy.orm import Session

from app.core.errors import GoneError, NotFoundError
from app.core.logs import tell
from app.db.session import Database
from app.foods.food_amounts import FoodAmounts
from app.foods.models import Component, Food
from app.meals import queries as meals
from app.meals.item_state import ItemState
from app.meals.meal_parts import parts_of, records_of
from app.meals.models import Meal, MealImage
from app.meals.record_models import CandidateSource, EffectiveRecord, Run, RunArtefact
from app.nutrition.nutrients import MassTotal, NutrientTotal, Portion, total_mass, total_nutrients
from app.people.access import audit
from app.people.access.access import known_studies, require_study
from app.people.access.caller import Caller, DeviceCaller
from app.records import queries as records
from app.records.probes import open_probes
from app.records.project_records import MealProjection, Projector
from app.records.read_after import AfterView, after_view
from app.storage.blob_store import BlobStore

NOBODY_KNOWS = MassTotal(None, 0)  # of a meal that failed or is not measured yet; confirmed without foods, it is 0


@dataclass(frozen=True, slots=True)
class ItemView:
    """An item as it stands with its effective record; food and amounts are None where it is no food yet.

    candidates: (food, probability, source); none_probability: that it is none of them, by the index of this version;
    None: not identified. open_probes: what the participant is to be asked of it.
    """

    state: ItemState
    record: EffectiveRecord
    food: Food | None
    candidates: tuple[tuple[Food, float | None, CandidateSource], ...]
    none_probability: float | None
    index_version: str | None
    amounts: FoodAmounts | None
    open_probes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class MealView:
    """Everything about one meal, detached from its session."""

    meal: Meal
    participant_code: str
    study_code: str
    images: tuple[MealImage, ...]
    run: Run | None
    artefacts: tuple[RunArtefact, ...]
    items: tuple[ItemView, ...]
    components: Mapping[str, Component]  # by number: those that the items have figures of
    total_mass: MassTotal
    totals: Mapping[str, NutrientTotal]
    after: AfterView


def find_meal(
    session: Session, caller: Caller, client_id: uuid.UUID, participant_code: str | None = None
) -> tuple[Meal, str, str]:
    """(meal, participant's code, study's code). Of several of the same id, the one that was here first.

    Raises NotFoundError where the caller may not see it, NotAllowedError for a lower role.
    """
    found = meals.find_meals(
        session,
        client_id,
        participant_id=caller.participant_id if isinstance(caller, DeviceCaller) else None,
        participant_code=participant_code,
        study_ids=known_studies(caller),
    )
    if not found:
        raise NotFoundError("There is no such meal.")
    require_study(caller, found[0][0].study_id, "meal")
    tell(meal_id=str(found[0][0].id))
    return found[0]


def read_meal(
    database: Database, caller: Caller, client_id: uuid.UUID, participant_code: str | None = None
) -> MealView:
    """The meal, its last run, items and records. Raises NotFoundError."""
    with database.read() as session:
        meal, participant, study = find_meal(session, caller, client_id, participant_code)
        return meal_view(session, meal, participant, study, Projector(session))


def meal_view(
    session: Session,
    meal: Meal,
    participant_code: str,
    study_code: str,
    projector: Projector,
    projection: MealProjection | None = None,
) -> MealView:
    """A meal as it stands in this session. projection: what it came to just now, where that is known."""
    if projection is None:
        projection = projector.project(parts_of(session, [meal])[0])
    run = projection.parts.run
    items = tuple(_items(session, projector, projection))
    portions = list(_portions(items))
    return MealView(
        meal=meal,
        participant_code=participant_code,
        study_code=study_code,
        images=tuple(meals.images_of(session, meal.id)),
        run=run,
        artefacts=tuple(records.artefacts_of(session, run.id)) if run else (),
        items=items,
        components=projector.components,
        total_mass=total_mass(portions) if portions or meal.status == "confirmed" else NOBODY_KNOWS,
        totals=total_nutrients(portions),
        after=after_view(session, projector, projection),
    )


def view_of_new_meal(meal: Meal, participant_code: str, study_code: str, images: Iterable[MealImage]) -> MealView:
    """A meal that was written down a moment ago, as `read_meal` would read it: nothing is known of its foods yet."""
    return MealView(
        meal=meal,
        participant_code=participant_code,
        study_code=study_code,
        images=tuple(sorted(images, key=lambda image: image.slot)),
        run=None,
        artefacts=(),
        items=(),
        components={},
        total_mass=NOBODY_KNOWS,
        totals={},
        after=AfterView(run=None, artefacts=(), leftovers=()),
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
        run = records.last_run(session, meal.id, purpose)
        found = [a for a in records.artefacts_of(session, run.id) if a.name == name] if run else []
        is_erased = any(image.erased_at is not None for image in meals.images_of(session, meal.id))
    if not found and is_erased:
        raise GoneError("The pictures of this meal were erased.", code="photograph_erased")
    if not found:
        raise NotFoundError(f"This meal has no artefact {name!r}: GET the meal to see which it has.")
    with database.write() as session:  # it shows the meal, as its photographs do
        audit.note(
            session, caller, "photograph.read", study_id=meal.study_id, subject=meal.alias, artefact=found[0].name
        )
    return found[0], blobs.stream(found[0].blob_key)


def _items(session: Session, projector: Projector, projection: MealProjection) -> Iterator[ItemView]:
    asked = open_probes(projector, projection.state)
    effective = records_of(session, projection.parts.meal.id)
    for found in projection.items:
        state, identified = found.state, found.candidates.identified
        yield ItemView(
            state=state,
            record=effective[state.item.id],
            food=projector.food(state.taken_for.food_id) if state.taken_for is not None else None,
            candidates=tuple(
                (projector.food(each.food_id), each.probability, each.source) for each in found.candidates.all
            ),
            none_probability=found.candidates.none_probability,
            index_version=identified.index_version if identified is not None else None,
            amounts=found.amounts,
            open_probes=asked.get(state.item.id, ()),
        )


def _portions(items: Iterable[ItemView]) -> Iterator[Portion]:
    """The items as terms of the meal's totals; one without a food counts as one whose mass is not known."""
    for view in items:
        if not view.state.is_live:
            continue
        if view.amounts is None:
            yield Portion("", {}, None, "before")
        else:
            yield from view.amounts.portions()
