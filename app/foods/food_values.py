"""A food's rows as the value that nutrition/ works with; its density pooled from all that is known of the same food."""

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import replace

from sqlalchemy.orm import Session

from app.foods import queries as foods
from app.foods.models import Food, FoodDensity, StudyDensity
from app.nutrition.density import DensityChoice, resolve_density
from app.nutrition.foods import Density, FoodForm, RefusePart
from app.nutrition.foods import Food as FoodValue
from app.nutrition.portions import Portion
from app.nutrition.search import label_key

_BASES_OF_OTHERS = ("measured", "fao", "portion")  # a relative or a group's median is each table's own judgement

# The starter table is made from SR28 and the FAO table: somebody has looked at what they say of each of its foods, and
# taken it, or left it out and put something better in its place. FoodData Central carries SR28's measures on.
_JUDGED = frozenset({"fdc", "sr28", "fao-density"})
_JUDGES = frozenset({"local", "starter"})


def food_value(session: Session, row: Food) -> FoodValue:
    """A food's row as a value. Its densities: its own, and behind them those of the same food in other tables."""
    return _value(session, row, pooled_densities(session, [row])[row.id])


def pooled_densities(session: Session, rows: Sequence[Food]) -> dict[int, tuple[Density, ...]]:
    """Food -> its densities: its own, and behind them those of the same food in other tables.

    The same food is one that shares a source's code; of a table of densities only, one of the same name (the order of
    its words and plurals aside) and the same state, which both tell: raw and cooked are never interchangeable.
    A correction replaces the food with the same key. Where the starter table has a density of a kind, it stands
    for what the tables that it is made from say of that kind: a food weighs the same by whichever key.
    """
    by_code = foods.same_foods(session, [row.id for row in rows])
    labels = {row.id: _labels(row) for row in rows if row.state is not None}
    by_label = foods.density_rows(session, set().union(*labels.values())) if labels else []
    others: dict[int, list[Food]] = {}
    for row in rows:
        of_name: dict[str, Food] = {}
        for label, food in by_label:
            if label in labels.get(row.id, ()) and food.state == row.state:
                of_name.setdefault(food.key, food)
        others[row.id] = [food for food in by_code[row.id] if food.key != row.key] + list(of_name.values())
    same = {food.id: food for row in rows for food in (row, *others[row.id])}
    sources = foods.sources_of(session, {food.release_id for food in same.values()})
    found = {
        food_id: tuple(map(density_value, its)) for food_id, its in foods.densities_of(session, same.keys()).items()
    }
    return {row.id: _pool(row, others[row.id], sources, found) for row in rows}


def _labels(row: Food) -> set[str]:
    return {label_key(label)[:300] for label in (row.name, *row.aliases)}


def _pool(
    row: Food, others: Sequence[Food], sources: Mapping[int, str], found: Mapping[int, tuple[Density, ...]]
) -> tuple[Density, ...]:
    same = (row, *others)
    judge = next((food for food in same if sources[food.release_id] in _JUDGES), None)
    judged = {density.kind for density in found.get(judge.id, ()) if density.basis != "group"} if judge else set()
    pooled: list[Density] = []
    for food in same:
        is_judged, named = sources[food.release_id] in _JUDGED, {density.source for density in pooled}
        pooled += [
            density
            for density in found.get(food.id, ())
            if density.source not in named
            and not (is_judged and density.kind in judged)
            and (food in (row, judge) or density.basis in _BASES_OF_OTHERS)
            and (food is row or density.basis != "group")
        ]
    return tuple(pooled)


def own_value(session: Session, row: Food) -> FoodValue:
    """A food's row as a value with no densities but its own: what a correction of it starts from."""
    return _value(session, row, own_densities(session, row))


def own_densities(session: Session, row: Food) -> tuple[Density, ...]:
    """The densities that this food has itself, best first."""
    return tuple(map(density_value, foods.densities_of(session, [row.id]).get(row.id, [])))


def bare_value(row: Food) -> FoodValue:
    """A food's row as a value, without what other tables hold: densities, figures and portions."""
    return FoodValue(
        key=row.key,
        name=row.name,
        aliases=tuple(row.aliases),
        food_group=row.food_group,
        form=row.form,
        slice_form=row.slice_form,
        refuse=tuple(RefusePart(**part) for part in row.refuse),
        densities=(),
        per_100_g={},
        source_ids=row.source_ids,
        state=row.state,
        is_mixed_dish=row.is_mixed_dish,
        probes=tuple(row.probes),
    )


def _value(session: Session, row: Food, densities: tuple[Density, ...]) -> FoodValue:
    return replace(
        bare_value(row),
        densities=densities,
        per_100_g={found.component.number: found.per_100_g for found in foods.nutrients_of(session, row.id)},
        portions=tuple(
            Portion(portion.sequence, portion.amount, portion.measure, portion.mass_g)
            for portion in foods.portions_of(session, row.id)
        ),
    )


def density_value(row: FoodDensity | StudyDensity) -> Density:
    """A density's row as a value."""
    basis = row.basis if isinstance(row, FoodDensity) else "study"
    columns = {name: getattr(row, name) for name in ("g_per_ml", "sd_g_per_ml", "state", "kind", "source", "weighs")}
    return Density(**columns, basis=basis)


def choose_density(
    session: Session, food: FoodValue, study_id: uuid.UUID | None, lies_as: FoodForm | None = None
) -> DensityChoice | None:
    """The density for this food in this study and form (None: as it usually lies); None if none is known."""
    own = foods.densities_of_studies(session, [study_id], food.key) if study_id is not None else []
    return resolve_density(food, form=lies_as, study_densities=[density_value(row) for row in own])
