"""Convert a food's rows to the value that nutrition/ works with, and pool the densities of the same food."""

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

# a relative or a group's median is each table's own judgement
_BASES_OF_OTHERS = ("measured", "fao", "portion")

# The starter table was compiled from SR28 and the FAO table: each of their densities for its foods
# was reviewed, and adopted, dropped or replaced by a better one. FoodData Central repeats SR28's
# measures.
_REVIEWED_SOURCES = frozenset({"fdc", "sr28", "fao-density"})
_REVIEWING_SOURCES = frozenset({"local", "starter"})


def food_value(session: Session, row: Food) -> FoodValue:
    """Return a food's row as a value; its own densities come first, then those of the same food in other tables."""
    return _value(session, row, pooled_densities(session, [row])[row.id])


def pooled_densities(session: Session, rows: Sequence[Food]) -> dict[int, tuple[Density, ...]]:
    """Return food id -> densities: the food's own first, then those of the same food in other tables.

    Two rows are the same food if they share a source's code. A row of a table that has only
    densities matches by name (ignoring word order and plurals) if both state the same state: raw
    and cooked are never interchangeable. A correction replaces the food with the same key. Where
    the starter table has a density of a kind, it replaces those of its source tables of that kind,
    so that a food weighs the same whichever key it is recorded by.
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
        others[row.id] = [food for food in by_code[row.id] if food.key != row.key] + list(
            of_name.values()
        )
    same = {food.id: food for row in rows for food in (row, *others[row.id])}
    sources = foods.sources_of(session, {food.release_id for food in same.values()})
    densities = {
        food_id: tuple(map(density_value, density_rows))
        for food_id, density_rows in foods.densities_of(session, same.keys()).items()
    }
    return {row.id: _pool(row, others[row.id], sources, densities) for row in rows}


def _labels(row: Food) -> set[str]:
    return {label_key(label)[:300] for label in (row.name, *row.aliases)}


def _pool(
    row: Food,
    others: Sequence[Food],
    sources: Mapping[int, str],
    densities: Mapping[int, tuple[Density, ...]],
) -> tuple[Density, ...]:
    same = (row, *others)
    reviewing_food = next(
        (food for food in same if sources[food.release_id] in _REVIEWING_SOURCES), None
    )
    reviewed = densities.get(reviewing_food.id, ()) if reviewing_food else ()
    reviewed_kinds = {density.kind for density in reviewed if density.basis != "group"}
    pooled: list[Density] = []
    for food in same:
        is_reviewed = sources[food.release_id] in _REVIEWED_SOURCES
        pooled_sources = {density.source for density in pooled}
        pooled += [
            density
            for density in densities.get(food.id, ())
            if density.source not in pooled_sources
            and not (is_reviewed and density.kind in reviewed_kinds)
            and (food in (row, reviewing_food) or density.basis in _BASES_OF_OTHERS)
            and (food is row or density.basis != "group")
        ]
    return tuple(pooled)


def own_value(session: Session, row: Food) -> FoodValue:
    """Return a food's row as a value with only its own densities: the starting point of a correction."""
    return _value(session, row, own_densities(session, row))


def own_densities(session: Session, row: Food) -> tuple[Density, ...]:
    """Return this food's own densities, best first."""
    return tuple(map(density_value, foods.densities_of(session, [row.id]).get(row.id, [])))


def bare_value(row: Food) -> FoodValue:
    """Return a food's row as a value without the contents of its other tables: densities, figures and portions."""
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
        per_100_g={
            nutrient.component.number: nutrient.per_100_g
            for nutrient in foods.nutrients_of(session, row.id)
        },
        portions=tuple(
            Portion(portion.sequence, portion.amount, portion.measure, portion.mass_g)
            for portion in foods.portions_of(session, row.id)
        ),
    )


def density_value(row: FoodDensity | StudyDensity) -> Density:
    """Return a density's row as a value."""
    basis = row.basis if isinstance(row, FoodDensity) else "study"
    columns = {
        name: getattr(row, name)
        for name in ("g_per_ml", "sd_g_per_ml", "state", "kind", "source", "weighs")
    }
    return Density(**columns, basis=basis)


def choose_density(
    session: Session, food: FoodValue, study_id: uuid.UUID | None, lies_as: FoodForm | None = None
) -> DensityChoice | None:
    """Return the density of this food in this study and form (None: its usual form); None if none is known."""
    own = foods.densities_of_studies(session, [study_id], food.key) if study_id is not None else []
    return resolve_density(food, form=lies_as, study_densities=[density_value(row) for row in own])
