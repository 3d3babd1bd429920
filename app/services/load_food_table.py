"""The starter table from the package into the database, once a version; and a food's row back to its value."""

from dataclasses import asdict
from datetime import UTC, datetime

from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from app.db.models import Component, Food, FoodDensity, FoodNutrient, FoodRelease
from app.db.queries import foods
from app.db.session import Database
from app.nutrition.components import COMPONENTS
from app.nutrition.foods import Density, FoodTable, RefusePart, load_starter_table
from app.nutrition.foods import Food as FoodValue


def load_starter(database: Database) -> None:
    """Load the packaged table if this version of it is not there; it becomes active if no other table is.

    Two processes may do it at once: one of them finds that the other was first.
    """
    table = load_starter_table()
    with database.read() as session:
        if foods.release_by_checksum(session, table.checksum) is not None:
            return
    try:
        with database.write() as session:
            if foods.release_by_checksum(session, table.checksum) is None:
                _insert(session, table)
    except IntegrityError:
        with database.read() as session:
            if foods.release_by_checksum(session, table.checksum) is None:
                raise


def food_value(session: Session, row: Food) -> FoodValue:
    """A food's row with its densities and nutrients as the value that nutrition/ works with."""
    return FoodValue(
        key=row.key,
        name=row.name,
        aliases=tuple(row.aliases),
        food_group=row.food_group,
        form=row.form,  # type: ignore[arg-type]  # FoodValue checks it
        slice_form=row.slice_form,  # type: ignore[arg-type]
        refuse=tuple(RefusePart(**part) for part in row.refuse),
        densities=tuple(
            Density(
                g_per_ml=density.g_per_ml,
                sd_g_per_ml=density.sd_g_per_ml,
                state=density.state,
                kind=density.kind,  # type: ignore[arg-type]  # Density checks both
                basis=density.basis,  # type: ignore[arg-type]
                source=density.source,
            )
            for density in foods.densities_of(session, row.id)
        ),
        per_100_g=foods.contents_of(session, row.id),
        source_ids=row.source_ids,
    )


def _insert(session: Session, table: FoodTable) -> None:
    known = foods.known_components(session)
    session.add_all(
        Component(tagname=component.tagname, name=component.name, unit=component.unit)
        for component in COMPONENTS
        if component.tagname not in known
    )
    current = foods.active_release(session)
    becomes_active = current is None or current.name == table.name  # an imported table is not pushed aside
    if current is not None and becomes_active:
        current.is_active = False
    release = FoodRelease(
        name=table.name,
        version=table.version,
        released_on=table.released_on,
        checksum=table.checksum,
        imported_at=datetime.now(UTC),
        is_active=becomes_active,
    )
    session.add(release)
    session.flush()
    for value in table.foods:
        row = Food(
            release_id=release.id,
            key=value.key,
            name=value.name,
            aliases=list(value.aliases),
            food_group=value.food_group,
            form=value.form,
            slice_form=value.slice_form,
            refuse=[asdict(part) for part in value.refuse],
            source_ids=dict(value.source_ids),
        )
        session.add(row)
        session.flush()
        session.add_all(
            FoodNutrient(food_id=row.id, tagname=tagname, per_100_g=content)
            for tagname, content in value.per_100_g.items()
        )
        session.add_all(
            FoodDensity(food_id=row.id, position=position, **asdict(density))
            for position, density in enumerate(value.densities)
        )
