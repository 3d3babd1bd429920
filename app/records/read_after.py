"""How the after-meal pair of a meal stands: its pieces, what they are of, what they weigh."""

from dataclasses import dataclass

from sqlalchemy.orm import Session

from app.foods.models import Food
from app.meals.item_state import LeftoverState
from app.meals.record_models import Run, RunArtefact
from app.nutrition.mass import Mass
from app.records import queries as records
from app.records.item_foods import weighing_of
from app.records.project_records import MealProjection, Projector
from app.records.served_mass import served_mass


@dataclass(frozen=True, slots=True)
class LeftoverView:
    """A piece. food: of the item that it is of, else what the phone said it is; mass: by that item's density."""

    state: LeftoverState
    food: Food | None
    mass: Mass | None


@dataclass(frozen=True, slots=True)
class AfterView:
    """The newest run of the after-meal pair and what it found."""

    run: Run | None
    artefacts: tuple[RunArtefact, ...]
    leftovers: tuple[LeftoverView, ...]


def after_view(session: Session, projector: Projector, projection: MealProjection) -> AfterView:
    """The after-meal pair in this session."""
    run = projection.parts.after_run
    return AfterView(
        run=run,
        artefacts=tuple(records.artefacts_of(session, run.id)) if run is not None else (),
        leftovers=tuple(_leftover(projector, projection, each) for each in projection.state.leftovers),
    )


def _leftover(projector: Projector, projection: MealProjection, leftover: LeftoverState) -> LeftoverView:
    its = [each.state for each in projection.items if each.state.item.id == leftover.of_item_id]
    taken_for = its[0].taken_for if its else leftover.state.taken_for
    return LeftoverView(
        state=leftover,
        food=projector.food(taken_for.food_id) if taken_for is not None else None,
        mass=served_mass(weighing_of(taken_for), leftover.state.amount) if taken_for is not None else None,
    )
