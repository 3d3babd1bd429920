"""Which food an item is taken for, as a row that is never changed: density and edible share as they were chosen."""

import uuid
from datetime import UTC, datetime

from sqlalchemy.orm import Session

from app.foods.food_amounts import Weighing, mass_of, weigh
from app.foods.food_values import choose_density, food_value
from app.foods.models import Food
from app.meals.stored.item_state import Amount
from app.meals.stored.record_models import ItemFood
from app.nutrition.foods import Density, food_form
from app.nutrition.mass import Mass, weighed_mass


def weighing_for(
    session: Session, food: Food, study_id: uuid.UUID, lies_as: str | None
) -> Weighing:
    """How an item that is this food, in this form, is weighed by what is known of the food now in this study."""
    value, form = food_value(session, food), food_form(lies_as)
    return weigh(value, choose_density(session, value, study_id, form), form)


def item_food(
    item_id: uuid.UUID,
    food_id: int,
    weighing: Weighing,
    lies_as: str | None,
    *,
    version: int = 1,
    layer: str = "automatic",
    event_id: uuid.UUID | None = None,
    recompute_id: uuid.UUID | None = None,
) -> ItemFood:
    """The row of an item that is taken for this food and weighed so.

    layer, event_id: by whose word.
    """
    density = weighing.density
    return ItemFood(
        item_id=item_id,
        version=version,
        food_id=food_id,
        lies_as=lies_as,
        density_g_per_ml=density.g_per_ml if density else None,
        density_sd_g_per_ml=density.sd_g_per_ml if density else None,
        density_state=density.state if density else None,
        density_kind=density.kind if density else None,
        density_basis=density.basis if density else None,
        density_source=density.source if density else None,
        density_weighs=density.weighs if density else None,
        edible_share=weighing.edible_share,
        layer=layer,
        event_id=event_id,
        recompute_id=recompute_id,
        created_at=datetime.now(UTC),
    )


def weighing_of(row: ItemFood) -> Weighing:
    """The row as the value that grams follow from."""
    if row.density_g_per_ml is None:
        return Weighing(None, row.edible_share)
    density = Density(
        g_per_ml=row.density_g_per_ml,
        sd_g_per_ml=row.density_sd_g_per_ml or 0.0,
        state=row.density_state or "",
        kind=row.density_kind,  # type: ignore[arg-type]  # Density checks all three
        basis=row.density_basis,  # type: ignore[arg-type]
        source=row.density_source or "",
        weighs=row.density_weighs,  # type: ignore[arg-type]
    )
    return Weighing(density, row.edible_share)


def served_mass(weighing: Weighing, amount: Amount) -> Mass | None:
    """The mass of a helping, or of what was left of one by its item's own density; None where it is not known.

    Grams that a person set go before volume and density.
    """
    if amount.mass is not None:
        is_edible = amount.mass.of == "edible"
        share = weighing.edible_share
        return weighed_mass(
            amount.mass.mass_g, amount.mass.relative_sd, is_edible=is_edible, edible_share=share
        )
    return mass_of(weighing, amount.volume_ml, amount.relative_sd)
