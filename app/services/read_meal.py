"""One meal as the phone or a researcher sees it: what has arrived, where it stands, what was found."""

import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from sqlalchemy.orm import Session

from app.db.models import Food, Item, Meal, MealImage, Run, RunArtefact
from app.db.queries import meals, records
from app.db.session import Database
from app.errors import ConflictError, NotFoundError
from app.services.caller import Caller, DeviceCaller
from app.storage.blob_store import BlobStore


@dataclass(frozen=True, slots=True)
class ItemView:
    """An item with its effective record (None only for a moment that no reader sees), food and candidates."""

    item: Item
    record: records.RecordRow
    candidates: tuple[tuple[Food, float | None, str], ...]
    nutrients: tuple[tuple[str, str, str, float], ...]  # tagname, name, unit, per 100 g edible


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


def find_meal(
    session: Session, caller: Caller, client_id: uuid.UUID, participant_code: str | None = None
) -> tuple[Meal, str, str]:
    """(meal, participant's code, study's code). Raises NotFoundError where the caller may not see it, ConflictError."""
    found = meals.find_meals(
        session,
        client_id,
        participant_id=caller.participant_id if isinstance(caller, DeviceCaller) else None,
        participant_code=participant_code,
    )
    if not found:
        raise NotFoundError("There is no such meal.")
    if len(found) > 1:
        raise ConflictError(
            "More than one participant has a meal of this id: add ?participant=CODE.", code="meal_id_ambiguous"
        )
    return found[0]


def read_meal(
    database: Database, caller: Caller, client_id: uuid.UUID, participant_code: str | None = None
) -> MealView:
    """The meal, its last run, items and records. Raises NotFoundError, ConflictError."""
    with database.read() as session:
        meal, participant, study = find_meal(session, caller, client_id, participant_code)
        run = records.last_run(session, meal.id)
        return MealView(
            meal=meal,
            participant_code=participant,
            study_code=study,
            images=tuple(meals.images_of(session, meal.id)),
            run=run,
            artefacts=tuple(records.artefacts_of(session, run.id)) if run else (),
            items=tuple(_items(session, run)) if run else (),
        )


def open_artefact(
    database: Database, blobs: BlobStore, caller: Caller, client_id: uuid.UUID, name: str, participant_code: str | None
) -> tuple[RunArtefact, Iterator[bytes]]:
    """An artefact of the meal's last run and its bytes. Raises NotFoundError, ConflictError, BlobMissingError."""
    with database.read() as session:
        meal, _, _ = find_meal(session, caller, client_id, participant_code)
        run = records.last_run(session, meal.id)
        found = [a for a in records.artefacts_of(session, run.id) if a.name == name] if run else []
    if not found:
        raise NotFoundError(f"This meal has no artefact {name!r}: GET the meal to see which it has.")
    return found[0], blobs.stream(found[0].blob_key)


def _items(session: Session, run: Run) -> Iterator[ItemView]:
    rows = records.records_of_run(session, run.id)
    candidates = records.candidates_of_run(session, run.id)
    nutrients: dict[int, tuple[tuple[str, str, str, Any], ...]] = {}
    for item, row in rows:
        food = row.food
        if food is not None and food.id not in nutrients:
            nutrients[food.id] = tuple(records.nutrients_of(session, food.id))
        yield ItemView(
            item=item,
            record=row,
            candidates=tuple(candidates.get(item.id, ())),
            nutrients=nutrients[food.id] if food is not None else (),
        )
